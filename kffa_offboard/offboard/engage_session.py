"""Taking control: the part of the offboard service that engages, and follows the vehicle's heartbeats."""

from __future__ import annotations

from kffa_offboard.offboard import admission, events, parameters, sequence, telemetry
from kffa_offboard.offboard.events import ModeKind, SetArmed, SetMode, Severity
from kffa_offboard.offboard.falling import shows
from kffa_offboard.offboard.flight import Phase, begin_flight, start_scenario
from kffa_offboard.offboard.loop import forget_sent
from kffa_offboard.offboard.rivals import forbids
from kffa_offboard.offboard.segments import Land, starts_on_ground
from kffa_offboard.offboard.sequence import Engagement, EngagePhase, EngageStep
from kffa_offboard.offboard.state import IDLE, REFUSED, SENDING, Finished, State
from kffa_offboard.offboard.telemetry_session import TelemetrySession


class EngageSession(TelemetrySession):
    """The part of the service that takes control; use `service.Service`."""

    __slots__ = ()

    def _refusal(self, time_us: int) -> str | None:
        """Why control cannot be taken now."""
        if self.finished is not None:
            return "finished; start the daemon again"
        if self.settings.shadow:
            return "shadow mode"
        unsafe = parameters.unsafe(self._parameters)
        if unsafe is not None:
            return unsafe
        if self.state not in IDLE:
            return f"already {self.state.value}"
        refusal = admission.refusal(
            self.settings, self._known, self._loop, self._link, self._battery, time_us
        )
        refusal = refusal or forbids(self._rivals, time_us)
        if refusal is not None or self.state is State.WAITING:
            return refusal or "not ready"
        grounded = self._grounded(time_us)
        if grounded is None:
            return "cannot tell whether it flies"
        if grounded and not starts_on_ground(self.settings.scenario):
            return "on the ground, and no take-off first"
        flown = None if grounded else telemetry.reported_thrust(self.settings.telemetry, self._known, time_us)
        refusal = admission.too_weak(self.settings.limits, flown)
        if refusal is None and self._loop is not None:
            refusal = admission.leaves_limits(self.settings, self._loop, grounded)
        if refusal is not None:
            return refusal
        return telemetry.outside_limits(self.settings.limits, self._known, self._ground_level(grounded))

    def _ground_level(self, grounded: bool) -> float:
        return self._loop.altitude if grounded and self._loop is not None else 0.0

    def _engage(self, time_us: int) -> None:
        """Take control, or say why not."""
        refusal = self._refusal(time_us)
        if refusal is not None:
            self._say(Severity.WARNING, f"not engaged: {refusal}")
            self._emit(events.RequestRefused(refusal, self.finished is not None or self.settings.shadow))
            forbidden = self._parameters.complete and parameters.unsafe(self._parameters) == refusal
            if forbidden and self.settings.engage:
                self._finish(Finished(False, f"not engaged: {refusal}"))
            return
        known = self._known
        grounded = self._grounded(time_us)
        assert known.heartbeat is not None and known.attitude is not None and known.position is not None
        assert grounded is not None and self._loop is not None
        self._engagement = sequence.begin_engagement(
            self.settings.sequence, time_us, known.heartbeat, grounded
        )
        altitude = self._loop.altitude if grounded else self._loop.hold_altitude
        self._flight = begin_flight(time_us, not grounded, altitude, known.attitude.attitude[2])
        self._loop = forget_sent(self._loop)
        self._centre = known.position.position[:2]
        self._followed = None
        self._said.clear()
        self._stay = False
        self._armed_here = False
        self._capture = False
        self.state = State.ENGAGING
        self._say(Severity.NOTICE, f"engaging {'on the ground' if grounded else 'in the air'}")

    def _run_engagement(self, time_us: int) -> None:
        assert self._engagement is not None and self._known.heartbeat is not None
        step = sequence.run_engagement(
            self.settings.sequence, self.settings.arm, self._engagement, time_us, self._known.heartbeat
        )
        self._follow_engagement(time_us, step)

    def _follow_engagement(self, time_us: int, step: EngageStep) -> None:
        if self._leaving:
            if step.takeover is not None or step.failure is not None:
                self._finish(self._outcome)
            elif step.engagement.phase is not EngagePhase.MODE or step.complete:
                self._release_granted(time_us, self._outcome)
            return
        was_waiting = self._engagement is not None and self._engagement.phase is EngagePhase.PERSON
        self._engagement = step.engagement
        self._emit(*step.outputs)
        if SetMode(ModeKind.OFFBOARD) in step.outputs:
            self._capture = True
        if step.takeover is not None:
            self._undo_arming(step.engagement)
            self._take_over(step.takeover)
        elif step.failure is not None:
            self._give_up_engaging(time_us, step.failure)
        elif step.complete:
            assert self._known.heartbeat is not None and self._flight is not None
            self._armed_here = step.engagement.arm_asked
            self._offboard_mode = self._known.heartbeat.custom_mode
            self._engagement = None
            self._flight = start_scenario(self._flight, time_us)
            self.state = State.ENGAGED
            self._say(Severity.NOTICE, "engaged")
        elif step.engagement.phase is EngagePhase.PERSON and not was_waiting:
            self._say(Severity.WARNING, "flies as soon as a person arms")

    def _undo_arming(self, engagement: Engagement) -> None:
        """Whoever takes over has not asked to arm: our request may be under way, so this one follows it."""
        retry = engagement.retry
        if retry is not None and retry.request == SetArmed(True) and retry.accepted_us is None:
            self._emit(SetArmed(False))
            self._say(Severity.CRITICAL, "may still arm: keep away")

    def _give_up_engaging(self, time_us: int, failure: str) -> None:
        """It did not come to that; what may still arm is disarmed first, and the daemon stays at hand."""
        assert self._engagement is not None
        self._say(Severity.WARNING, f"not engaged: {failure}")
        if not self._engagement.arm_asked:
            self._let_go(State.READY)
            return
        self._stay = self._armed_here = True
        self._release_on_ground(time_us, Finished(False, failure))

    def _follow_heartbeat(self, time_us: int, event: events.HeartbeatReceived) -> None:
        """What a heartbeat means for the present state."""
        if event.killed and self.state in SENDING:
            self._killed()
            if self.state not in SENDING:
                return
        offboard = event.mode is ModeKind.OFFBOARD
        match self.state:
            case State.ENGAGING:
                assert self._engagement is not None
                step = sequence.heartbeat_in_engagement(
                    self.settings.sequence, self.settings.arm, self._engagement, time_us, event
                )
                self._follow_engagement(time_us, step)
            case State.ENGAGED:
                if not event.armed:
                    self._disarmed_in_flight()
                elif not offboard or event.custom_mode != self._offboard_mode:
                    self._take_over(f"mode {event.mode_name}")
            case State.RELEASING:
                open_request = self._may_still_arm(event)
                if not (event.armed or open_request):
                    self._finish(self._outcome)
                elif not (offboard or (self._lands_to_disarm and event.mode is ModeKind.LAND)):
                    self._finish(REFUSED if self._lands_to_disarm else self._outcome)
            case State.FAILSAFE:
                ours = self._may_still_arm(event) or event.armed
                if self._retry is not None and (not offboard or not ours):
                    self._finish(self._outcome)
            case _:
                pass

    def _killed(self) -> None:
        """A kill switch: in a fall the law goes on, to catch the vehicle if it is let again; else not."""
        if shows(self._fall):
            self._say_once(Severity.WARNING, "kill switch: the motors are stopped")
            return
        if self._engagement is not None:
            self._undo_arming(self._engagement)
        self._take_over("kill switch")

    def _disarmed_in_flight(self) -> None:
        """The autopilot's own disarming after landing is no surprise; any other is somebody's decision."""
        flight = self._flight
        assert flight is not None
        index, scenario = flight.scenario.segment_index, self.settings.scenario
        landing = index < len(scenario) and isinstance(scenario[index], Land)
        if flight.phase is Phase.TOUCHDOWN or (landing and flight.seen_in_air and self._known.on_ground):
            self._finish(self._landed)
        else:
            self._take_over("disarmed")

    def _restarted(self, armed: bool) -> None:
        """The first heartbeat tells whether the flight of an earlier run still goes on."""
        if self._interrupted and armed and self._auto_engage:
            self._auto_engage = False
            self._say(Severity.WARNING, "restarted in flight: only observing")
        self._interrupted = False
