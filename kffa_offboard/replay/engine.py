"""The daemon's own session, fed from a recording."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from math import nan

from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import DaemonConfig
from kffa_offboard.config_log import make_companion, recorded_keeper
from kffa_offboard.control.plain import Vector
from kffa_offboard.flightlog.signals import to_message
from kffa_offboard.frame_codec import decode
from kffa_offboard.mavlink.commands import is_timesync_request
from kffa_offboard.mavlink.component import Component, Route
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.session_protocols import ProcessRequest
from kffa_offboard.mavlink.shell import pass_barrier, take_message
from kffa_offboard.mavlink.transport import Datagram, Posting
from kffa_offboard.offboard.events import ProcessReport, Signals
from kffa_offboard.offboard.service import Service
from kffa_offboard.replay.recording import Frame, Recording, is_message, is_report
from kffa_offboard.replay.uncollected import uncollected


@dataclass
class Replayed:
    """What the session did: frames that it sent and frames of its inner signals, with their times [us].

    `applied` is what the observer was told at each control step, by its time, unrounded.
    """

    sent: list[Frame] = field(default_factory=list)
    signals: list[Frame] = field(default_factory=list)
    applied: dict[int, Vector] = field(default_factory=dict)


class NoLink:
    """A link to nowhere that takes everything."""

    name = "replay"
    keeps_frames_whole = True
    trouble = ""
    descriptor = None

    def take_news(self) -> str | None:
        """See `transport.Link`."""
        return None

    def receive(self, timeout_s: float) -> list[Datagram]:
        """See `transport.Link`."""
        return []

    def send(self, data: bytes) -> bool:
        """See `transport.Link`."""
        return True

    def posting(self, data: bytes) -> Posting | None:
        """See `transport.Link`."""
        return None

    def lock(self, source: Hashable) -> None:
        """See `transport.Link`."""

    def close(self) -> None:
        """See `transport.Link`."""


class _Collector:
    """A recorder that keeps what the session itself produced."""

    def __init__(self, route: Route) -> None:
        self.replayed = Replayed()
        self._own = bytes((route.own_system, route.own_component))
        self._signals = Component(route)

    def write(self, time_us: int, frame: bytes) -> None:
        if frame[5:7] == self._own:
            self.replayed.sent.append((time_us, frame))

    def write_signals(self, signals: Signals) -> None:
        self.replayed.signals.append((signals.time_us, self._signals.pack(to_message(signals))))
        self.replayed.applied[signals.time_us] = signals.applied

    def write_begin(self, time_us: int) -> None:
        pass

    def write_request(self, time_us: int, request: ProcessRequest) -> None:
        pass

    def write_report(self, time_us: int, report: ProcessReport) -> None:
        pass

    def write_end(self, time_us: int, reason: str, frames_dropped: int) -> None:
        pass


def replay_what_if(recording: Recording, flown: DaemonConfig, config: DaemonConfig) -> Replayed:
    """Drive the session of `config` through a flight that was flown with the configuration `flown`.

    The observer is told what the vehicle got then, not what `config` would have asked for: the samples answer
    to that. If the two command different things (rates, attitude), roll, pitch and yaw are taken to have been
    commanded to do what they did.
    """
    applied = replay(recording, flown).applied
    if config.service.output != flown.service.output:
        applied = {time_us: (nan, nan, nan, command[3]) for time_us, command in applied.items()}
    return replay(recording, config, applied)


def _pass_over(session: Session, time_us: int, frame: bytes) -> None:
    """That something came: what is left to be done on the vehicle then goes on."""
    with suppress(mavlink.MAVError):  # the daemon did not understand it either
        session.handle(time_us, decode(frame))


@uncollected()
def replay(recording: Recording, config: DaemonConfig, flown: Mapping[int, Vector] | None = None) -> Replayed:
    """Drive the session of `config` through everything that came in, at the times when it came.

    `flown` are the commands that acted, by the times of the control steps, if they are not the session's own.
    """
    ids = config.link
    route = Route(ids.system_id, ids.component_id, ids.target_system, ids.target_component)
    collector = _Collector(route)
    lockstep = recording.header.lockstep
    session = Session(
        Service(config.service, flown=flown),
        NoLink(),
        route,
        recorder=collector,
        parameters=recorded_keeper(recording.header, config, route, recording.path),
        guided_mode=config.autopilot.ardupilot_mode,
        companion=make_companion(config, route),
        compare_clocks=not lockstep,
    )
    session.advance(recording.begin_us)
    for time_us, item in recording.incoming:
        if isinstance(item, bytes):
            if session.service.finished is not None:
                _pass_over(session, time_us, item)
        elif not is_message(item):
            (session.report if is_report(item) else session.request)(time_us, item)
        elif not lockstep:
            take_message(session, time_us, item)
        elif is_timesync_request(item) and route.from_target(item):
            pass_barrier(session, time_us, item)
        else:
            session.handle(time_us, item)
    session.advance(recording.end_us)
    return collector.replayed
