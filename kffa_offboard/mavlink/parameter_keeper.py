"""Parameters at connect: read, judge, set on request, and put back at the end; sans-I/O.

Rules for changing anything on the vehicle:

- only with `fix`, only what a finding has a value for, and only while the vehicle is disarmed;
- what it was is on record (`ChangeRecord`) before the first PARAM_SET leaves;
- values go back when the service has finished and the vehicle is disarmed or out of OFFBOARD (a change of
  GUID_OPTIONS under a live setpoint would change what its thrust means), within `RESTORE_LIMIT_US`;
- what an earlier run left behind goes back at the next connect, while disarmed; a value that somebody
  else has changed since is theirs and stays.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import Enum

from kffa_offboard.mavlink import parameter_check_ardupilot, parameter_check_px4
from kffa_offboard.mavlink.component import Message, Route
from kffa_offboard.mavlink.parameter_check import Checks, CheckSettings, Finding, judge_all, relevant
from kffa_offboard.mavlink.parameter_file import ChangedParameter, ChangeRecord
from kffa_offboard.mavlink.parameter_transfer import ParameterTransfer
from kffa_offboard.mavlink.parameters import encoding_of, name_of, same_value, version_request
from kffa_offboard.offboard.events import (
    Announce,
    Firmware,
    HeartbeatReceived,
    ModeKind,
    ParameterProblem,
    ParametersChecked,
    Severity,
)

CHECKS: dict[Firmware, Checks] = {
    "px4": parameter_check_px4.CHECKS,
    "ardupilot": parameter_check_ardupilot.CHECKS,
}
MESSAGES = ("PARAM_VALUE", "PARAM_ERROR", "AUTOPILOT_VERSION")
RECONNECT_US = 3_000_000
"""After a silence of the heartbeat this long the vehicle may have been restarted: read again."""

RESTORE_LIMIT_US = 5_000_000


class _Phase(Enum):
    WAITING = "waiting"  # for a heartbeat
    READING = "reading"
    SETTING = "setting"  # on request, or what an earlier run left behind
    WATCHING = "watching"
    HOLDING = "holding"  # finished; waiting until values may go back
    RESTORING = "restoring"
    DONE = "done"


@dataclass(frozen=True, slots=True)
class KeeperSettings:
    """What is to be done with parameters.

    Attributes
    ----------
    check : what they are judged against
    fix : set what a finding has a value for
    shadow : change nothing, not even back
    """

    check: CheckSettings
    fix: bool = False
    shadow: bool = False


@dataclass(slots=True)
class Todo:
    """What a call asks for: messages to the vehicle, events for the service, lines for people."""

    messages: list[Message] = field(default_factory=list)
    events: list[ParametersChecked] = field(default_factory=list)
    announcements: list[Announce] = field(default_factory=list)


class ParameterKeeper:
    """One vehicle's parameters, from its first heartbeat to the end of the run.

    Attributes
    ----------
    changes : what is changed on the vehicle and must go back

    """

    def __init__(self, route: Route, settings: KeeperSettings, record: ChangeRecord) -> None:
        self.changes: tuple[ChangedParameter, ...] = ()
        self._route = route
        self._settings = settings
        self._record = record
        self._transfer = ParameterTransfer(route, "c-cast")
        self._phase = _Phase.WAITING
        self._heartbeat: HeartbeatReceived | None = None
        self._heartbeat_us = 0
        self._restore_by_us = 0
        self._judged: tuple[ParameterProblem, ...] = ()
        self._asked_version = False
        self._todo = Todo()

    @property
    def done(self) -> bool:
        """Nothing is left to do on the vehicle, or it was given up."""
        return self._phase in (_Phase.WAITING, _Phase.DONE)

    def take(self) -> Todo | None:
        """What the calls so far ask for; None for nothing."""
        if not (self._todo.messages or self._todo.events or self._todo.announcements):
            return None
        todo, self._todo = self._todo, Todo()
        return todo

    def due_us(self) -> int | None:
        """When `advance` must be called next; None if only a message can change anything."""
        if self._phase in (_Phase.READING, _Phase.SETTING):
            return self._transfer.due_us()
        if self._phase is _Phase.RESTORING:
            return min(self._restore_by_us, self._transfer.due_us() or self._restore_by_us)
        return self._restore_by_us if self._phase is _Phase.HOLDING else None

    # --------------------------------------------------------------------------- inputs

    def heartbeat(self, time_us: int, heartbeat: HeartbeatReceived) -> None:
        """The vehicle is there; the first time (or after a silence) its parameters are read."""
        silent = time_us - self._heartbeat_us >= RECONNECT_US
        self._heartbeat, self._heartbeat_us = heartbeat, time_us
        if self._phase is _Phase.WAITING:
            self._transfer = ParameterTransfer(self._route, encoding_of(heartbeat.firmware, None))
            self.changes = self._record.load(heartbeat.firmware)
            self._begin_reading()
        elif silent and self._phase is _Phase.WATCHING:
            self._begin_reading()
        elif heartbeat.armed and self._phase is _Phase.SETTING:
            self._warn("armed: parameters are not set any further")
            self._transfer.cancel()
        self.advance(time_us)

    def receive(self, time_us: int, message: Message) -> None:
        """Take in one of `MESSAGES` of the vehicle."""
        if self._phase is _Phase.WAITING or self._heartbeat is None:
            return
        if message.get_type() == "AUTOPILOT_VERSION":
            self._transfer.encoding = encoding_of(self._heartbeat.firmware, message.capabilities)
        else:
            self._transfer.receive(message)
            if self._phase is _Phase.WATCHING and name_of(message) in self._checks:
                self._judge()
        self.advance(time_us)

    def finish(self, time_us: int) -> None:
        """The service has finished: put back what was changed. May be called again."""
        if self._phase in (_Phase.WAITING, _Phase.HOLDING, _Phase.RESTORING, _Phase.DONE):
            return
        if not self.changes or self._settings.shadow:
            self._phase = _Phase.DONE
            return
        self._transfer.cancel()
        self._phase = _Phase.HOLDING
        self._restore_by_us = time_us + RESTORE_LIMIT_US
        self.advance(time_us)

    def advance(self, time_us: int) -> None:
        """Do what is due."""
        if self._phase in (_Phase.READING, _Phase.SETTING, _Phase.RESTORING):
            self._todo.messages += self._transfer.run(time_us)
            if not self._transfer.busy:
                self._transferred(time_us)
        if self._phase is _Phase.HOLDING and self._may_restore():
            self._phase = _Phase.RESTORING
            self._put_back(self.changes)
            self._todo.messages += self._transfer.run(time_us)
        if self._phase in (_Phase.HOLDING, _Phase.RESTORING) and time_us >= self._restore_by_us:
            self._settle_changes()
            self._phase = _Phase.DONE

    # ------------------------------------------------------------------------- phases

    @property
    def _checks(self) -> Checks:
        assert self._heartbeat is not None
        return relevant(CHECKS[self._heartbeat.firmware], self._settings.check)

    def _begin_reading(self) -> None:
        self._phase = _Phase.READING
        self._todo.events.append(ParametersChecked((), complete=False))
        self._transfer.read(dict.fromkeys([*self._checks, *(change.name for change in self.changes)]))
        if not self._asked_version:
            self._asked_version = True
            self._todo.messages.append(version_request(self._route))

    def _transferred(self, time_us: int) -> None:
        """A transfer is over."""
        if self._phase is _Phase.READING:
            self._after_reading(time_us)
        elif self._phase is _Phase.SETTING:
            self._settle_changes(keep_new=self._settings.fix)
            self._phase = _Phase.WATCHING
            self._judge()
        else:
            self._settle_changes()
            if self.changes and time_us < self._restore_by_us:
                self._put_back(self.changes)  # a starved or slow link: try on until the limit
            if not self._transfer.busy:
                self._phase = _Phase.DONE

    def _after_reading(self, time_us: int) -> None:
        assert self._heartbeat is not None
        self._phase = _Phase.WATCHING
        wanted = self._wanted_changes() if self._settings.fix else ()
        idle = not wanted and (self._settings.fix or not self.changes)
        if idle or self._settings.shadow:
            self._judge()
        elif self._heartbeat.armed:
            self._warn("armed: parameters stay as they are; disarm and start again")
            self._judge()
        else:
            self._phase = _Phase.SETTING
            if self._settings.fix:
                self._apply(wanted)
            else:
                self._put_back(self.changes)
            self._todo.messages += self._transfer.run(time_us)
            if not self._transfer.busy:
                self._transferred(time_us)

    def _wanted_changes(self) -> tuple[ChangedParameter, ...]:
        """What is to be set; a value that an earlier run changed keeps its place on record."""
        before = {change.name: change.old for change in self.changes}
        values = self._transfer.values()
        return tuple(
            ChangedParameter(finding.name, before.get(finding.name, values[finding.name]), finding.fix)
            for finding in self._findings()
            if finding.fix is not None and finding.name in values
        )

    def _apply(self, wanted: tuple[ChangedParameter, ...]) -> None:
        """On record first, then on the wire."""
        assert self._heartbeat is not None
        names = {change.name for change in wanted}
        self.changes = (*(change for change in self.changes if change.name not in names), *wanted)
        self._record.save(self._heartbeat.firmware, self.changes)
        self._transfer.set({change.name: change.new for change in wanted})
        for change in wanted:
            self._say(f"{change.name} set to {change.new:g}; {change.old:g} comes back at the end")

    def _put_back(self, changes: Iterable[ChangedParameter]) -> None:
        """Set the old values, except where somebody else has set another one since."""
        values = self._transfer.values()
        still_ours = {
            change.name: change.old
            for change in changes
            if change.name in values
            and (same_value(values[change.name], change.new) or change.name in self._transfer.unanswered)
        }
        self._transfer.set(still_ours)

    def _settle_changes(self, keep_new: bool = False) -> None:
        """After a transfer: strike off the record what has its old value, or somebody else's."""
        assert self._heartbeat is not None
        values = self._transfer.values()
        left: list[ChangedParameter] = []
        for change in self.changes:
            value = values.get(change.name)
            if value is None or same_value(value, change.new) or change.name in self._transfer.unanswered:
                left.append(change)
            elif same_value(value, change.old):
                if not keep_new:
                    self._say(f"{change.name} is {change.old:g} again")
            else:
                self._say(f"{change.name} is {value:g} now, set by somebody else; left so")
        self.changes = tuple(left)
        self._record.save(self._heartbeat.firmware, self.changes)

    def _may_restore(self) -> bool:
        heartbeat = self._heartbeat
        return heartbeat is not None and (not heartbeat.armed or heartbeat.mode is not ModeKind.OFFBOARD)

    # ------------------------------------------------------------------------ judging

    def _findings(self) -> tuple[Finding, ...]:
        return judge_all(self._checks, self._settings.check, self._transfer.values())

    def _judge(self) -> None:
        """Tell the service, if anything is different from what it was told last."""
        found = [finding.problem for finding in self._findings()]
        if not self._transfer.known:
            text = "no answer to parameter requests; nothing is known of them"
            found.append(ParameterProblem("", "warning", text))
        self._todo.events.append(ParametersChecked(tuple(found)))

    def _say(self, text: str) -> None:
        self._todo.announcements.append(Announce(Severity.NOTICE, text))

    def _warn(self, text: str) -> None:
        self._todo.announcements.append(Announce(Severity.WARNING, text))
