"""Several vehicles in one process: one loop, each vehicle with its own link, log, state and end."""

from __future__ import annotations

import select
import threading
import traceback
from contextlib import ExitStack
from types import TracebackType

from kffa_offboard.cli_report import FAILED, reason, report
from kffa_offboard.cli_status import complain
from kffa_offboard.cli_vehicle import RunOptions, Shared, VehicleRun, open_vehicle
from kffa_offboard.config import DaemonConfig
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.shell import LONGEST_SLEEP_S, RealTimeLoop


class _Member:
    """A vehicle in the loop. `due_us`: its next turn, if nothing arrives before."""

    def __init__(self, vehicle: VehicleRun, loop: RealTimeLoop, stack: ExitStack, now_us: int) -> None:
        self.vehicle = vehicle
        self.loop = loop
        self.stack = stack
        self.due_us = now_us


class Fleet:
    """Opens vehicles and flies them until each has ended. A context manager: leaving it closes the logs.

    Attributes
    ----------
    status : 0, or 1 once anything went wrong with one of them

    """

    def __init__(self, shared: Shared, options: RunOptions, stop: threading.Event) -> None:
        self.status = 0
        self._shared = shared
        self._options = options
        self._stop = stop
        self._members: list[_Member] = []
        self._closing: list[threading.Thread] = []

    def __enter__(self) -> Fleet:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        for member in [*self._members]:
            self._close(member)
        for thread in self._closing:
            thread.join()

    def open(self, name: str, config: DaemonConfig) -> None:
        """Make a vehicle ready; what is wrong with its link or log is said, and stops it alone."""
        stack, shared = ExitStack(), self._shared
        try:
            vehicle = stack.enter_context(open_vehicle(config, self._options, shared, name))
        except UserError as error:
            self._fail(name, error)
            return
        timeout_s = config.link.connect_timeout_s
        loop = RealTimeLoop(vehicle.session, shared.clock, self._stop, timeout_s, vehicle.watch)
        self._members.append(_Member(vehicle, loop, stack, shared.clock()))

    def fly(self) -> None:
        """Turn the loop until all have ended."""
        while self._members:
            descriptors = {member.vehicle.session.link.descriptor: member for member in self._members}
            waiting = [descriptor for descriptor in descriptors if descriptor is not None]
            due_us = min(member.due_us for member in self._members)
            wait_s = min(max((due_us - self._shared.clock()) / 1e6, 0.0), LONGEST_SLEEP_S)
            readable, _, _ = select.select(waiting, [], [], wait_s)
            now_us, ready = self._shared.clock(), {id(descriptors[each]) for each in readable}
            for member in [*self._members]:
                if id(member) in ready or member.due_us <= now_us:
                    self._turn(member)

    def _turn(self, member: _Member) -> None:
        """One turn of one vehicle; its troubles are its own, mistakes of this program included."""
        name, session = member.vehicle.name, member.vehicle.session
        try:
            member.loop.turn(session.link.receive(0.0))
            if member.loop.goes_on():
                member.due_us = self._shared.clock() + round(member.loop.wait_s() * 1e6)
                return
            result = member.loop.result()
            session.close(reason(result))
            self.status = report(self._shared.console, result, member.vehicle, self._options) or self.status
        except UserError as error:
            session.close(str(error))
            self._fail(name, error)
        except Exception as error:
            traceback.print_exc()
            self._fail(name, error)
        self._close(member)

    def _close(self, member: _Member) -> None:
        """In a thread of its own: closing a log waits for the disk."""
        self._members.remove(member)
        member.vehicle.session.fall_silent()
        thread = threading.Thread(target=self._close_now, args=(member,), name="closing")
        thread.start()
        self._closing.append(thread)

    def _close_now(self, member: _Member) -> None:
        try:
            member.stack.close()
        except UserError as error:
            self._fail(member.vehicle.name, error)

    def _fail(self, name: str, error: Exception) -> None:
        self.status = FAILED
        for line in str(error).splitlines():
            complain(f"{name}: {line}")
