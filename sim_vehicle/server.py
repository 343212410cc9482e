"""The shell around the simulated vehicle: sockets, and where its time comes from.

Real time: simulated time follows the wall clock. Lock-step: simulated time goes on by one period when the
controller has answered a TIMESYNC request, the barrier:

1. after each period the vehicle sends what is due, then TIMESYNC with tc1 = 0 and ts1 = simulated time [ns];
2. it waits for TIMESYNC with the same ts1 and tc1 not 0;
3. everything received before that answer counts as sent at that simulated time.

Requests are not delayed by the simulated link; the controller takes its clock from them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from typing import Any, TypeAlias

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.config import LockstepSection
from sim_vehicle.errors import SimulatorError
from sim_vehicle.links import Links
from sim_vehicle.vehicle import SimulatedVehicle

LARGEST_LAG_S = 0.1
"""If the machine is this far behind, simulated time is let go rather than caught up in a burst."""

SILENCE_S = 15.0
"""A peer that only ever called (udpin) and has been silent this long is forgotten."""

REPEAT_S = 0.2
"""The first barrier is repeated this often, for a controller that is not up yet."""

PROGRESS_S = 0.2
"""How often progress is reported [s of wall time]."""

Progress: TypeAlias = Callable[[SimulatedVehicle], None]


class _Reporter:
    """Calls back at most every PROGRESS_S of wall time."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress = progress
        self._next = 0.0

    def __call__(self, vehicle: SimulatedVehicle) -> None:
        now = time.monotonic()
        if self._progress is not None and now >= self._next:
            self._next = now + PROGRESS_S
            self._progress(vehicle)


def run_real_time(
    vehicle: SimulatedVehicle, links: Links, duration_s: float | None, progress: Progress | None = None
) -> None:
    """Fly by the wall clock until `duration_s` of simulated time have passed, or for ever if None."""
    end_us = None if duration_s is None else round(duration_s * 1e6)
    step_us = round(vehicle.config.vehicle.physics_dt_s * 1e6)
    report = _Reporter(progress)
    heard: dict[Hashable, float] = {}
    origin = time.monotonic() - vehicle.time_us * 1e-6
    while end_us is None or vehicle.time_us < end_us:
        next_step = origin + (vehicle.time_us + step_us) * 1e-6
        _take_in(vehicle, links, next_step - time.monotonic(), heard)
        lag = time.monotonic() - next_step
        if lag < 0.0:
            continue
        origin += lag if lag > LARGEST_LAG_S else 0.0
        target = round((time.monotonic() - origin) * 1e6)
        vehicle.advance(target if end_us is None else min(target, end_us))
        _send_out(vehicle, links)
        report(vehicle)


def _take_in(vehicle: SimulatedVehicle, links: Links, timeout_s: float, heard: dict[Hashable, float]) -> None:
    """Receive for at most `timeout_s`, greet those who connected, forget those who left."""
    for peer, data in links.receive(timeout_s):
        if data:
            heard[peer] = time.monotonic()
            vehicle.receive(data, peer)
        else:
            heard.pop(peer, None)
            vehicle.remove_peer(peer)
    known = links.peers()
    for peer in known:
        vehicle.add_peer(peer)
    if heard:
        oldest = min(heard, key=lambda key: heard[key])
        if time.monotonic() - heard[oldest] > SILENCE_S and oldest not in known:
            heard.pop(oldest)
            vehicle.remove_peer(oldest)


def _send_out(vehicle: SimulatedVehicle, links: Links) -> None:
    for peer, data in vehicle.outgoing():
        links.send(peer, data)


def run_lockstep(
    vehicle: SimulatedVehicle, links: Links, duration_s: float | None, progress: Progress | None = None
) -> None:
    """Fly in lock-step with one controller: the first endpoint's peer, or whoever calls first.

    Raises SimulatorError if the controller does not answer in time.
    """
    settings = vehicle.config.lockstep
    period_us = round(settings.period_s * 1e6)
    end_us = None if duration_s is None else round(duration_s * 1e6)
    report = _Reporter(progress)
    barrier = _Barrier(vehicle, links, settings)
    while True:
        _send_out(vehicle, links)
        barrier.wait()
        report(vehicle)
        if end_us is not None and vehicle.time_us >= end_us:
            return
        vehicle.advance(vehicle.time_us + period_us)


class _Barrier:
    """Holds simulated time until the controller has answered."""

    def __init__(self, vehicle: SimulatedVehicle, links: Links, settings: LockstepSection) -> None:
        self._vehicle = vehicle
        self._links = links
        self._settings = settings
        self._parser: Any = mavlink.MAVLink(file=None, srcSystem=0, srcComponent=0)
        self._parser.robust_parsing = True
        self._met = False
        self._request = b""
        known = links.peers()
        for peer in known:
            vehicle.add_peer(peer)
        self._controller: Hashable | None = known[0] if known else None

    def wait(self) -> None:
        """Ask, and take in everything until the answer has come."""
        settings = self._settings
        limit = settings.answer_timeout_s if self._met else settings.connect_timeout_s
        deadline = time.monotonic() + limit
        self._request = b""
        self._ask()
        while True:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise self._silence(limit)
            received = self._links.receive(left if self._met else min(left, REPEAT_S))
            if self._take(received):
                self._met = True
                return
            if not self._met:
                self._ask()

    def _ask(self) -> None:
        """Send the request; a repeated one is the same frame, so that how often it took leaves no trace."""
        if self._controller is None:
            return
        self._request = self._request or self._vehicle.time_request(self._controller)
        self._links.send(self._controller, self._request)

    def _take(self, received: list[tuple[Any, bytes]]) -> bool:
        """Hand everything to the vehicle; was the answer among it?"""
        answered = False
        for peer, data in received:
            if not data:
                if peer == self._controller:
                    raise SimulatorError(
                        f"lock-step: the controller closed its link at {self._vehicle.time_us * 1e-6:.2f} s"
                    )
                self._vehicle.remove_peer(peer)
                continue
            if self._controller is None:
                self._controller = peer
            self._vehicle.receive(data, peer)
            if peer == self._controller:
                answered |= self._answers(data)
        return answered

    def _answers(self, data: bytes) -> bool:
        wanted = self._vehicle.time_us * 1000
        messages = self._parser.parse_buffer(data) or []
        return any(
            message.get_type() == "TIMESYNC" and message.tc1 != 0 and message.ts1 == wanted
            for message in messages
        )

    def _silence(self, limit: float) -> SimulatorError:
        at = f"at {self._vehicle.time_us * 1e-6:.2f} s of simulated time"
        if self._controller is None:
            return SimulatorError(f"lock-step: nobody called within {limit:g} s; start the controller")
        what = "stopped answering" if self._met else "never answered"
        return SimulatorError(
            f"lock-step: the controller {what} TIMESYNC {at} for {limit:g} s; "
            "is it running, in lock-step mode, on the same link?"
        )
