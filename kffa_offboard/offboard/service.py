"""The offboard service: events in, messages out; no socket, no clock, no randomness.

States: waiting -> ready -> engaging -> engaged -> releasing, and failsafe from the last three. In
waiting and ready nothing is in the daemon's hands, so a fault of telemetry there means "not ready"
and starts the observers anew instead of ending the run.

Rules, each kept in one place:

- setpoints leave only through `_control` and `_resend`, and only in engaging, engaged, releasing;
- before an event every deadline up to its time is run, each at its own nominal time; deadlines are
  not stored but follow from the state, so none can be forgotten or outlive its reason;
- what a control step means for log and load is worked out when its setpoint is on the way: the first thing
  due after it, at the time of the step;
- after giving up control nothing is sent until somebody asks again (PX4 would return to OFFBOARD).

`engage_session.py` and `session.py` hold the other half, taking and giving back control;
`telemetry_session.py` what is asked of telemetry, and what it says beside its samples; `control_session.py`
the control step; `payload_session.py` gripper and load; `request_session.py` what others ask for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter

from msgspec.structs import replace

from kffa_offboard.control.plain import Vector
from kffa_offboard.offboard import admission, echo, events, telemetry, trust
from kffa_offboard.offboard.control_session import ControlSession
from kffa_offboard.offboard.events import Event, Output, SetArmed, SetMode, Severity
from kffa_offboard.offboard.farewell import fly_blind
from kffa_offboard.offboard.horizontal import astray, position_jump
from kffa_offboard.offboard.loop import begin_loop
from kffa_offboard.offboard.sequence import (
    accept_retry,
    engagement_due,
    microseconds,
    mode_granted,
    refuse_disarming,
    retry_due,
)
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import ENGAGED, IDLE, READY, SENDING, WAITING, Finished, State

__all__ = ["Finished", "Service", "State"]

Deadline = tuple[int, Callable[[int], None]]
_moment = itemgetter(0)

QUIET_SHARE = 0.4
"""Of the silence that ends control; telemetry is asked for again then."""


class Service(ControlSession):
    """The one place that holds state between events; all values inside are frozen.

    Give it every event with its arrival time (microseconds of any clock that does not go back), call
    `advance` at `next_deadline`, and send what they return in that order.

    `flown` has the commands that really acted, by the times of the control steps, for a recorded flight with
    other settings than it was flown with (see `loop.step_loop`).
    """

    __slots__ = ()

    def __init__(self, settings: ServiceSettings, *, flown: Mapping[int, Vector] | None = None) -> None:
        super().__init__(settings)
        if flown is not None:
            self._flown = flown
        self._earliest: Deadline | None = None

    def handle(self, time_us: int, event: Event) -> list[Output]:
        """Run the deadlines up to `time_us`, then the event; return what is to be sent.

        Raises
        ------
        ValueError
            If `time_us` is earlier than that of a former call.
        """
        self._run_deadlines(time_us)
        self._earliest = None
        self._dispatch(time_us, event)
        if self.finished is not None and self._stepped is not None:
            self._follow_step(time_us)
        return self._take_outputs()

    def advance(self, time_us: int) -> list[Output]:
        """Run the deadlines up to `time_us`; return what is to be sent. Raises as `handle`."""
        self._run_deadlines(time_us)
        return self._take_outputs()

    def next_deadline(self) -> int | None:
        """When `advance` must be called next, microseconds; None before the first call."""
        if self._now_us is None:
            return None
        return (self._earliest or self._next())[0]

    def _take_outputs(self) -> list[Output]:
        outputs, self._outputs = self._outputs, []
        return outputs

    # ------------------------------------------------------------------------ deadlines

    def _run_deadlines(self, time_us: int) -> None:
        if self._now_us is None:
            self._own_heartbeat_us = time_us
        elif time_us < self._now_us:
            raise ValueError(
                f"event at {time_us} us comes after one at {self._now_us} us; keep them in order"
            )
        while (deadline := self._earliest or self._next())[0] <= time_us:
            due, run = deadline
            self._now_us = due if self._now_us is None else max(due, self._now_us)
            self._earliest = None
            run(due)
        self._now_us = time_us

    def _next(self) -> Deadline:
        """The earliest deadline; looked for again after what may change it, an event or a deadline.

        What follows a control step comes first: all that was due by the time of the step is done.
        """
        if self._stepped is not None:
            self._earliest = self._stepped[1].trace.time_us, self._follow_step
        else:
            self._earliest = self._first_due()
        return self._earliest

    def _first_due(self) -> Deadline:
        """All else that is due some time; of two at the same time the later one in this list goes first."""
        settings, known, sending = self.settings, self._known, self.state in SENDING
        first: Deadline = self._own_heartbeat_us, self._beat
        if self._request_us is not None and self._request_us <= first[0]:
            first = self._request_us, self._check_rates
        if self._gripper_us is not None or self._release_plan is not None:
            for deadline in reversed(self._payload_deadlines()):
                first = deadline if deadline[0] <= first[0] else first
        if sending and self._loop is not None and self._loop.sent is not None:
            resend_us = self._loop.sent_us + microseconds(settings.sequence.resend_s)
            if resend_us <= first[0]:
                first = resend_us, self._resend
        if self._retry is not None:
            first = min((retry_due(self._retry), self._run_release), first, key=_moment)
        if self._engagement is not None:
            first = min((engagement_due(self._engagement), self._run_engagement), first, key=_moment)
        if known.heartbeat is not None:
            lost_us = known.heartbeat_us + microseconds(settings.telemetry.heartbeat_timeout_s)
            if lost_us <= first[0]:
                first = lost_us, self._heartbeat_lost
        return self._silence(first) if sending or self.state is READY else first

    def _silence(self, first: Deadline) -> Deadline:
        """The earlier one of a deadline and what is done when no telemetry comes."""
        settings, known = self.settings.telemetry, self._known
        attitude_us, position_us = known.attitude_stream.arrival_us, known.position_stream.arrival_us
        if attitude_us is not None and position_us is not None and self._may_ask_again():
            older_us = attitude_us if attitude_us < position_us else position_us
            quiet_us = older_us + microseconds(QUIET_SHARE * settings.timeout_s)
            if quiet_us <= first[0] and self._asked_again_us <= first[0]:
                first = max(quiet_us, self._asked_again_us), self._ask_again
        if position_us is not None:
            silent_us = position_us + microseconds(settings.position_timeout_s)
            if silent_us <= first[0]:
                first = silent_us, self._no_position
        if attitude_us is not None:
            silent_us = attitude_us + microseconds(settings.timeout_s)
            if silent_us <= first[0]:
                first = silent_us, self._no_attitude
        return first

    def _no_attitude(self, time_us: int) -> None:
        self._fault(time_us, f"no attitude for {self.settings.telemetry.timeout_s:g} s")

    def _no_position(self, time_us: int) -> None:
        self._fault(time_us, f"no position for {self.settings.telemetry.position_timeout_s:g} s")

    def _heartbeat_lost(self, time_us: int) -> None:
        self._request_us = None
        self._fault(time_us, f"no heartbeat for {self.settings.telemetry.heartbeat_timeout_s:g} s")
        self._known = telemetry.forget_heartbeat(self._known)

    def _beat(self, time_us: int) -> None:
        if self.state is State.FAILSAFE:
            self._emit(events.OwnHeartbeat("critical"))
        else:
            self._emit(events.OwnHeartbeat("active" if self.state in SENDING else "standby"))
        self._own_heartbeat_us = time_us + microseconds(self.settings.sequence.own_heartbeat_s)

    def _resend(self, time_us: int) -> None:
        """Something is to be heard while no telemetry comes: PX4 wants 2 Hz."""
        assert self._loop is not None
        engagement = self._engagement
        acting = engagement is None or engagement.grounded or mode_granted(engagement)
        self._loop, target = fly_blind(
            self.settings, self._loop, self._flight, self._known, time_us, acting=acting
        )
        self._emit(target)
        self._echo = echo.send(self._echo, time_us, target.thrust)

    # --------------------------------------------------------------------------- events

    def _dispatch(self, time_us: int, event: Event) -> None:
        match event:
            case events.AttitudeReceived():
                self._on_attitude(time_us, event)
            case events.PositionReceived():
                self._on_position(time_us, event)
            case events.HeartbeatReceived():
                self._on_heartbeat(time_us, event)
            case events.TargetReported():
                self._known = telemetry.receive_target(self._known, time_us, event)
                self._watch_echo(time_us, event)
            case events.ThrottleReported():
                self._known = telemetry.receive_throttle(self._known, time_us, event)
            case events.LandedStateReported():
                self._known = telemetry.receive_landed(self._known, time_us, event)
            case events.CommandAnswered():
                self._on_answer(time_us, event)
            case events.EngageRequested():
                self._engage(time_us)
            case events.ReleaseRequested():
                self._release(time_us, event.reason, event.stay)
            case events.GiveUpRequested():
                self._give_up(time_us)
            case events.HangNoticed():
                self._hung(event.seconds)
            case events.StatusReceived():
                pass  # the log has it
            case _:
                self._on_request(time_us, event)

    def _on_heartbeat(self, time_us: int, event: events.HeartbeatReceived) -> None:
        first = self._known.heartbeat is None
        if self.state in IDLE:
            self._asked_again = 0
        self._restarted(event.armed)
        self._known = telemetry.receive_heartbeat(self._known, time_us, event)
        if first:
            self._requests = 0
            self._said.clear()
            if self.state in IDLE:
                self._request_rates(time_us)
        self._follow_heartbeat(time_us, event)

    def _on_position(self, time_us: int, event: events.PositionReceived) -> None:
        before, last = self._known, self._known.position
        self._known, sample = telemetry.receive_position(
            self.settings.telemetry, self.settings.limits, self._known, time_us, event
        )
        jump = position_jump(self.settings.position, last, event) if sample.accepted else None
        fault = sample.fault or jump
        if sample.accepted and fault is None:
            self._trust, fits, fault = trust.watch_position(
                self.settings.telemetry, self.settings.limits, self._trust, time_us, event, self._flying()
            )
            if not fits:
                self._known = trust.pass_over(before)
                self._say_once(Severity.WARNING, "climb rate jumps: sample passed over")
            elif fault is None:
                self._watch_fall(event)
        if fault is not None:
            self._fault(time_us, fault)
        else:
            self._check_limits(time_us)

    def _on_attitude(self, time_us: int, event: events.AttitudeReceived) -> None:
        self._known, sample = telemetry.receive_attitude(
            self.settings.telemetry, self.settings.limits, self._known, time_us, event
        )
        if sample.fault is not None:
            self._fault(time_us, sample.fault)
            return
        if not sample.accepted:
            return
        self._trust, fault = trust.watch_attitude(
            self.settings.telemetry, self.settings.limits, self._trust, time_us, event, self._flying()
        )
        if fault is not None:
            self._fault(time_us, fault)
            return
        self._check_limits(time_us)
        if self._loop is None:
            self._loop = begin_loop(self.settings, self._known, time_us)
        elif sample.dt > 0.0:
            self._control(time_us, sample.dt)
        may = time_us >= self._asked_again_us and self._may_ask_again()
        if may and telemetry.slowed_down(self.settings.telemetry, self._known, time_us):
            self._ask_again(time_us)
        if self.state is WAITING:
            self._try_ready(time_us)
        if self.state is READY and self._auto_engage and self._grounded(time_us) is not None:
            self._auto_engage = False
            self._engage(time_us)

    def _check_limits(self, time_us: int) -> None:
        if self._engagement is not None and self._engagement.grounded:
            grounded = self._grounded(time_us)
            if grounded is not None and not grounded:
                self._take_over("it flies")  # our zero thrust would be a fall
        if self.state in SENDING and self._flight is not None:
            ground = self._flight.scenario.ground
            outside = telemetry.outside_limits(self.settings.limits, self._known, ground)
            outside = outside or admission.outside_fence(self.settings.limits, self._known, self._centre)
            if outside is None and self.state is ENGAGED:
                outside = admission.slow(self.settings, self._known, time_us)
            if outside is None:
                outside = self._fallen(ground)
            if outside is None and self._loop is not None:
                outside = astray(self.settings.position, self._loop.horizontal)
            if outside is not None:
                self._failsafe(time_us, outside)

    def _try_ready(self, time_us: int) -> None:
        if (
            self._loop is None
            or not self._parameters.complete
            or telemetry.not_ready(self.settings.telemetry, self._known, time_us) is not None
            or admission.slow(self.settings, self._known, time_us) is not None
        ):
            return
        doubt = admission.doubted(self.settings, self._known, time_us)
        if doubt is not None:
            self._say_once(Severity.WARNING, f"not ready: {doubt}")
            return
        self.state = State.READY
        self._say(Severity.INFO, "ready")

    # -------------------------------------------------------------------------- answers

    def _on_answer(self, time_us: int, event: events.CommandAnswered) -> None:
        """Take in a COMMAND_ACK."""
        refused = not event.accepted and not event.in_progress
        match event.action:
            case "gripper":
                self._gripper_answered(time_us, event)
            case "mode" | "arm" | "disarm":
                if event.accepted:
                    self._on_accepted(time_us, event.action)
            case _:
                pass
        if refused and event.action == "disarm" and self.state is State.RELEASING:
            assert self._retry is not None
            self._retry = refuse_disarming(self._retry, time_us)
        if refused and event.action != "other":
            self._say_once(Severity.WARNING, f"{event.action} refused: {event.result_name}")

    def _on_accepted(self, time_us: int, action: str) -> None:
        """Note that the pending request was accepted, if it is that one."""
        if self._engagement is not None and self._engagement.retry is not None:
            if _answers(action, self._engagement.retry.request):
                retry = accept_retry(self._engagement.retry, time_us)
                self._engagement = replace(self._engagement, retry=retry)
                if self._leaving:
                    self._release_granted(time_us, self._outcome)
        elif self._retry is not None and _answers(action, self._retry.request):
            self._retry = accept_retry(self._retry, time_us)
            if self.state is State.FAILSAFE and isinstance(self._retry.request, SetMode):
                self._finish(self._outcome)  # that it is disarmed a heartbeat has to show


def _answers(action: str, request: SetMode | SetArmed) -> bool:
    return action == ("mode" if isinstance(request, SetMode) else "arm" if request.armed else "disarm")
