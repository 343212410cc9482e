"""Giving control back: what the offboard service knows, and how it releases or fails.

The half of `service.Service` that decides; the other half (`service.py`) keeps time and makes the
control steps. Everything that changes `state` is here and in `engage_session.py`, except between waiting
and ready.
"""

from __future__ import annotations

from math import nan

from msgspec.structs import replace

from kffa_offboard.offboard import admission, events, sequence, telemetry
from kffa_offboard.offboard.echo import Echo
from kffa_offboard.offboard.events import (
    Announce,
    AttitudeTarget,
    ModeKind,
    Output,
    SetArmed,
    SetMode,
    Severity,
)
from kffa_offboard.offboard.external import External
from kffa_offboard.offboard.falling import NO_FALL, carried_before
from kffa_offboard.offboard.farewell import farewell
from kffa_offboard.offboard.flight import (
    Ending,
    FlightState,
    Phase,
    abandon_takeoff,
    hold_here,
    stands,
)
from kffa_offboard.offboard.guard import Wish
from kffa_offboard.offboard.loop import LoopState, forget_sent
from kffa_offboard.offboard.rivals import Rivals
from kffa_offboard.offboard.sequence import Engagement, EngagePhase, Retry, begin_retry
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import IDLE, KEPT, LANDED, REFUSED, SENDING, UNCONFIRMED, Finished, State
from kffa_offboard.offboard.trust import Trust


class Session:
    """State and transitions of the service; use `service.Service`.

    Attributes
    ----------
    settings : as given
    state : present state
    finished : None while the service may still fly
    """

    __slots__ = KEPT

    def __init__(self, settings: ServiceSettings) -> None:
        self.settings = settings
        self._original = settings
        self.state = State.WAITING
        self.finished: Finished | None = None
        self._now_us: int | None = None
        self._outputs: list[Output] = []
        self._known = telemetry.Telemetry()
        self._parameters = events.ParametersChecked(())
        self._loop: LoopState | None = None
        self._flight: FlightState | None = None
        self._engagement: Engagement | None = None
        self._retry: Retry | None = None
        self._outcome = Finished(True, "")
        self._leaving = False
        self._armed_here = False
        self._offboard_mode = 0
        self._auto_engage = settings.engage and not settings.shadow
        self._interrupted = settings.interrupted
        self._capture = False
        self._said: set[str] = set()
        self._own_heartbeat_us = 0
        self._request_us: int | None = None
        self._requests = 0
        self._gripper_us: int | None = None
        self._link: events.LinkMeasured | None = None
        self._latency_s = nan
        self._battery: events.BatteryReported | None = None
        self._trust = Trust()
        self._fall = NO_FALL
        self._rivals = Rivals()
        self._echo = Echo()
        self._centre: tuple[float, float] | None = None
        self._followed: tuple[Wish, int] | None = None
        self._stay = False
        self._external: External | None = None

    @property
    def counts(self) -> tuple[int, int, int]:
        """Dropped attitude samples, dropped position samples, messages with numbers that are not finite."""
        known = self._known
        return known.attitude_stream.dropped, known.position_stream.dropped, known.invalid

    def _emit(self, *outputs: Output) -> None:
        self._outputs.extend(outputs)

    def _say(self, severity: Severity, text: str) -> None:
        self._emit(Announce(severity, text))

    def _say_once(self, severity: Severity, text: str) -> None:
        if text not in self._said:
            self._said.add(text)
            self._say(severity, text)

    # ----------------------------------------------------------------------- letting go

    def _grounded(self, time_us: int) -> bool | None:
        """Is the vehicle on the ground? None if that cannot be told: then there is no engaging."""
        return admission.grounded(self.settings, self._known, time_us)

    def _may_still_arm(self, heartbeat: events.HeartbeatReceived) -> bool:
        """The daemon's request to arm is still open; a heartbeat that shows it done settles it."""
        if self._retry is not None and heartbeat.armed:
            self._retry = replace(self._retry, undoes_open=False)
        return self._retry is not None and self._retry.undoes_open

    @property
    def _lands_to_disarm(self) -> bool:
        """Disarming was refused, and LAND mode has the time of another disarming to do it by itself."""
        retry = self._retry
        asks = retry is not None and retry.request == SetMode(ModeKind.LAND)
        return self.state is State.RELEASING and self._armed_here and asks

    def _take_over(self, what: str) -> None:
        """Somebody else decided: stop at once; only a new request engages again."""
        if self._leaving:
            self._finish(self._outcome)
            return
        self._auto_engage = False
        self._let_go(State.READY)
        self._say(Severity.WARNING, f"control given up: {what}")

    def _hung(self, seconds: float) -> None:
        """The daemon did nothing for so long that it has lost control: no last words, and no request.

        PX4 returns to OFFBOARD with the next setpoint, whatever its own failsafe has begun meanwhile.
        """
        if self.state in SENDING:
            self._take_over(f"the daemon hung for {seconds:.1f} s")
        elif self._retry is not None:
            self._finish(self._outcome)

    def _let_go(self, state: State) -> None:
        """Nothing is in the daemon's hands any more."""
        self.state = state
        self._leaving = False
        self._engagement = None
        self._flight = None
        self._external = None
        self._retry = None
        self._gripper_us = None
        if self._loop is not None:
            self._loop = forget_sent(self._loop)

    def _finish(self, outcome: Finished) -> None:
        """The end of this run, unless the daemon is to stay at hand; a failsafe stays one."""
        stays = self.state in (State.FAILSAFE, State.WAITING)
        self._let_go(self.state if stays else State.READY)
        self._auto_engage = False
        self.finished = None if self._stay else outcome
        severity = Severity.NOTICE if outcome.successful else Severity.WARNING
        self._say(severity, f"released: {outcome.reason}")

    # ------------------------------------------------------------------------ releasing

    def _release(self, time_us: int, reason: str, stay: bool) -> None:
        """Somebody asks the daemon to give control back; it then engages only if asked to.

        To stay at hand does not undo that the end was asked for, or a failsafe.
        """
        outcome = Finished(True, reason)
        ends = self._leaving or self.state in (State.RELEASING, State.FAILSAFE)
        self._stay = stay and (self._stay or not ends)
        if self.state in IDLE:
            if self.finished is None and not stay:
                self._finish(outcome)
            elif self._auto_engage:
                self._auto_engage = False
                self._say(Severity.NOTICE, "engages only when asked to")
        elif self.state is State.ENGAGING:
            assert self._engagement is not None
            if sequence.mode_granted(self._engagement):
                self._release_granted(time_us, outcome)
            elif self._engagement.phase is EngagePhase.STREAM:
                self._finish(outcome)
            elif not self._leaving:
                self._leaving, self._outcome = True, outcome
                self._engagement = sequence.ask_no_more(self.settings.sequence, self._engagement, time_us)
        elif self.state is State.ENGAGED:
            assert self._flight is not None
            if self._flight.phase is Phase.AIR:
                self._release_in_air(time_us, outcome)
            elif self._flight.phase is Phase.GROUND:
                self._release_on_ground(time_us, outcome)
            elif self._flight.phase is Phase.RAMP:
                sent = self._loop.sent if self._loop is not None else None
                thrust = sent.thrust if sent is not None else 0.0
                self._flight = abandon_takeoff(self._flight, time_us, thrust, outcome)

    def _release_granted(self, time_us: int, outcome: Finished) -> None:
        """OFFBOARD is granted, or was while the release waited for that: there is something to give back."""
        assert self._engagement is not None
        if self._engagement.grounded:
            self._armed_here = self._engagement.arm_asked
            self._release_on_ground(time_us, outcome)
        else:
            self._release_in_air(time_us, outcome)

    @property
    def _landed(self) -> Finished:
        """How a flight ends that is on the ground."""
        assert self._flight is not None
        return self._flight.outcome or LANDED

    def _end_flight(self, time_us: int, ending: Ending, reason: str | None) -> None:
        """The scenario is over."""
        match ending:
            case Ending.LANDED:
                self._release_on_ground(time_us, self._landed)
            case Ending.IN_AIR:
                self._release_in_air(time_us, Finished(True, "scenario done, in the air"))
            case Ending.FAULT:
                self._failsafe(time_us, reason or "scenario cannot go on")

    def _release_on_ground(self, time_us: int, outcome: Finished) -> None:
        """Disarm what was armed here; what a person armed is left to the autopilot's LAND mode."""
        timing = self.settings.sequence
        heartbeat = self._known.heartbeat
        if not self._armed_here and (heartbeat is None or not heartbeat.armed):
            self._finish(outcome)
            return
        if self._armed_here:
            retry = begin_retry(SetArmed(False), time_us, timing.disarm_retry_s, timing.disarm_timeout_s)
            retry = replace(retry, undoes_open=self.state is State.ENGAGING)
        else:
            land = SetMode(ModeKind.LAND)
            retry = begin_retry(land, time_us, timing.hold_retry_s, timing.hold_timeout_s)
        assert self._flight is not None
        self._flight = replace(self._flight, phase=Phase.GROUND)
        self._begin_release(time_us, retry, outcome)

    def _release_in_air(self, time_us: int, outcome: Finished) -> None:
        """Hold here and ask for HOLD; setpoints go on until a heartbeat shows another mode."""
        assert self._flight is not None and self._loop is not None
        timing = self.settings.sequence
        self._flight = hold_here(self._flight, self._loop.hold_altitude, self._loop.hold_offset)
        hold = SetMode(ModeKind.HOLD)
        retry = begin_retry(hold, time_us, timing.hold_retry_s, timing.hold_timeout_s)
        self._begin_release(time_us, retry, outcome)

    def _begin_release(self, time_us: int, retry: Retry, outcome: Finished) -> None:
        self.state = State.RELEASING
        self._leaving = False
        self._engagement = None
        self._retry = retry
        self._outcome = outcome
        self._run_release(time_us)

    def _run_release(self, time_us: int) -> None:
        """Run the request of releasing or failsafe at its deadline."""
        assert self._retry is not None
        self._retry, outputs, expired = sequence.run_retry(self._retry, time_us)
        self._emit(*outputs)
        if expired:
            self._release_expired(time_us)

    def _release_expired(self, time_us: int) -> None:
        """The request has had its time."""
        assert self._retry is not None
        timing = self.settings.sequence
        request, outcome = self._retry.request, self._outcome
        # Whoever accepted it: the heartbeats since then have not shown it.
        contradicted = sequence.contradicted(timing, self._retry, self._known.heartbeat_us)
        accepted = self._retry.accepted_us is not None and not contradicted
        if self._lands_to_disarm:
            self._finish(REFUSED)
        elif self._retry.undoes_open:
            self._say(Severity.CRITICAL, "may still arm: keep away")
            self._finish(outcome if self.state is State.FAILSAFE else UNCONFIRMED)
        elif accepted:
            self._finish(outcome)
        elif isinstance(request, SetArmed):
            self._say(Severity.CRITICAL, "still armed on the ground: keep away")
            self._ask_to_land(time_us)
        elif self.state is State.FAILSAFE:
            self._finish(outcome)
        else:
            reason = f"{request.mode.name} not confirmed; setpoints stopped"
            self._say_farewell()
            self._finish(Finished(False, reason))

    def _ask_to_land(self, time_us: int) -> None:
        """Let LAND mode disarm; in failsafe, which sends no setpoints, too."""
        timing, land = self.settings.sequence, SetMode(ModeKind.LAND)
        if self.state is State.FAILSAFE:
            self._retry = begin_retry(land, time_us, timing.hold_retry_s, timing.hold_timeout_s)
            self._run_release(time_us)
            return
        retry = begin_retry(land, time_us, timing.hold_retry_s, timing.disarm_timeout_s)
        self._begin_release(time_us, retry, self._outcome)

    def _give_up(self, time_us: int) -> None:
        """There is no more time for releasing: what would be said at its end is said now."""
        self._stay = False  # the process ends, whatever was asked for since the stop
        if self.finished is None and self.state is State.ENGAGED:
            self._say_farewell()
            self._release_on_ground(time_us, self._landed)  # only a thrust ramp outlasts the release
        if self.finished is None and self._retry is not None:
            self._release_expired(time_us)
        if self.finished is None:
            self._finish(REFUSED if self.state is State.RELEASING else self._outcome)

    # ------------------------------------------------------------------------- failsafe

    @property
    def has_control(self) -> bool:
        """Setpoints may be what flies the vehicle."""
        return self.state in SENDING

    def last_setpoints(self) -> tuple[AttitudeTarget, ...]:
        """Those of `last_words`, while nothing ends yet: for others to send if this process is gone."""
        return self._farewell() if self.state in SENDING else ()

    def last_words(self) -> list[Output]:
        """The process ends in the middle of control: the last setpoint, whatever else is due.

        Nothing is worked out for it, so that it can be had from a program that has just failed.
        """
        self._outputs.clear()
        if self.state in SENDING:
            self._say_farewell()
            self._let_go(State.FAILSAFE)
            self._say(Severity.CRITICAL, "failsafe: the daemon ended")
            self.finished = Finished(False, "failsafe: the daemon ended")
        outputs, self._outputs = self._outputs, []
        return outputs

    def _fault(self, time_us: int, reason: str) -> None:
        """Telemetry is not to be trusted: failsafe if in control, else begin anew."""
        if self.state in SENDING:
            self._failsafe(time_us, reason)
            return
        if self.state is State.READY:
            self.state = State.WAITING
            self._say(Severity.WARNING, f"not ready: {reason}")
        self._known = telemetry.forget_samples(self._known)
        self._trust = Trust()
        self._loop = None

    def _failsafe(self, time_us: int, reason: str) -> None:
        """Give up control in the configured way."""
        request, engaging = self._failsafe_request(), self._engagement is not None
        self._say_farewell()
        self._let_go(State.FAILSAFE)
        self._stay = False
        self._say(Severity.CRITICAL, f"failsafe: {reason}")
        self._outcome = Finished(False, f"failsafe: {reason}")
        if request is None:
            self._finish(self._outcome)
            return
        timing = self.settings.sequence
        retry = begin_retry(request, time_us, timing.hold_retry_s, timing.hold_timeout_s)
        self._retry = replace(retry, undoes_open=engaging and isinstance(request, SetArmed))
        self._run_release(time_us)

    def _say_farewell(self) -> None:
        """The autopilot flies the last setpoint on until it notices our silence: let that be a level one."""
        self._emit(*self._farewell())

    def _farewell(self) -> tuple[AttitudeTarget, ...]:
        if self._engagement is not None and not sequence.mode_granted(self._engagement):
            return ()  # the autopilot does not listen to ours yet
        loop = self._loop
        if loop is not None:
            loop = replace(loop, carrying=carried_before(self._fall, loop.carrying))
        return farewell(self.settings, loop, self._flight, self._known)

    def _failsafe_request(self) -> SetMode | SetArmed | None:
        """On the ground disarm what was armed here; in the air the configured mode, if any.

        A thrust ramp counts as the ground, and touch-down: the autopilot refuses to disarm what has left it.
        """
        flight, engagement = self._flight, self._engagement
        if flight is not None and stands(flight, self._known.on_ground):
            armed_here = engagement.arm_asked if engagement is not None else self._armed_here
            if armed_here or flight.phase is Phase.GROUND:
                return SetArmed(False) if armed_here else None
        if engagement is not None and not sequence.mode_granted(engagement):
            return None  # it is not ours to bring down: the pilot's, or the autopilot's own failsafe's
        action = self.settings.failsafe_action
        if action == "stop":
            return None
        return SetMode(ModeKind.HOLD if action == "hold" else ModeKind.LAND)
