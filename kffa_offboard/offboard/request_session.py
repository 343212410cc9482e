"""What others ask of the service beside engaging and releasing: gripper, other numbers, setpoints.

Setpoints from outside are followed while engaged, in the air, and only if the configuration leaves room for
them: without a scenario, or in a segment "external".
"""

from __future__ import annotations

from msgspec.structs import replace

from kffa_offboard.control.retuning import as_before
from kffa_offboard.offboard import admission, events, external, parameters, rivals, steps, telemetry
from kffa_offboard.offboard.events import AttitudeSetpoint, Event, PositionSetpoint, Severity
from kffa_offboard.offboard.flight import Directive, Phase
from kffa_offboard.offboard.guard import Wish, check_wish
from kffa_offboard.offboard.payload_session import PayloadSession
from kffa_offboard.offboard.reference import current_segment
from kffa_offboard.offboard.segments import External
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import SENDING, State

MOST_REASONS = 20
"""So many reasons for not following setpoints are said in one engagement: a stream has ever new ones."""


class RequestSession(PayloadSession):
    """The part of the service that answers requests; use `service.Service`."""

    __slots__ = ()

    def _on_request(self, time_us: int, event: Event) -> None:
        match event:
            case events.GripperRequested():
                self._gripper_requested(time_us, event.action)
            case events.SettingsChanged():
                self._on_settings(time_us, event.settings)
            case events.LinkMeasured():
                self._on_link_measured(time_us, event)
            case events.BatteryReported():
                self._on_battery(event)
            case events.EstimateReported():
                self._on_estimate(time_us, event)
            case PositionSetpoint() | AttitudeSetpoint():
                self._on_setpoint(time_us, event)
            case events.ParametersChecked():
                self._on_parameters(event)
            case events.IntrusionNoticed():
                self._on_intrusion(time_us, event)
            case _:
                pass

    def _on_settings(self, time_us: int, settings: ServiceSettings) -> None:
        """Other numbers, unless that would end control at once."""
        latency_s = telemetry.latency_on_arrival_s(self._known, self._link, time_us)
        refusal = admission.unbearable(self.settings, settings, self._known, latency_s, self._link, time_us)
        if self._loop is not None and self._loop.carrying is not None:
            refusal = refusal or admission.too_weak(settings.limits, self._loop.carrying.thrust)
        refusal = refusal or steps.too_far(self.settings, settings, self._original)
        if refusal is not None and self.state in SENDING:
            self._emit(events.RequestRefused(refusal))
            return
        self._retune(as_before(self.settings, settings))

    def _on_link_measured(self, time_us: int, measured: events.LinkMeasured) -> None:
        """One late sample is jitter; two at successive measurements, or late answers, are a slow link."""
        before_s, self._link = self._latency_s, measured
        self._latency_s = telemetry.latency_on_arrival_s(self._known, measured, time_us)
        steady_s = min(self._latency_s, before_s)  # NaN, not measured, if the first one is; else the other
        late = admission.late(self.settings, steady_s, measured, admission.LATENCY_IN_FLIGHT)
        if late is not None and self.state in SENDING:
            self._failsafe(time_us, late)

    def _on_battery(self, reported: events.BatteryReported) -> None:
        """In flight the autopilot's own battery failsafe acts; here it is only said."""
        self._battery = reported
        low = admission.empty(self.settings.limits, reported)
        if low is not None and self.state in SENDING:
            self._say_once(Severity.WARNING, "battery low")

    def _on_intrusion(self, time_us: int, noticed: events.IntrusionNoticed) -> None:
        """Two who command one vehicle is worse than none: its own failsafe flies it better."""
        self._rivals, news = rivals.notice(self._rivals, time_us, noticed)
        if news:
            self._say(Severity.WARNING, noticed.text)
        if self.state in SENDING and rivals.fought_over(self._rivals, time_us):
            self._failsafe(time_us, self._rivals.text)

    def _on_parameters(self, checked: events.ParametersChecked) -> None:
        if checked.complete:
            self._emit(*parameters.announcements(self._parameters, checked))
            self._parameters = checked
        else:  # what was found before is not news when it is found again
            self._parameters = replace(self._parameters, complete=False)

    # ------------------------------------------------------------------------ setpoints

    def _not_following(self) -> str | None:
        """Why setpoints from outside are not followed now."""
        if self.state is not State.ENGAGED or self._flight is None:
            return "not engaged"
        if self._flight.phase is not Phase.AIR:
            return "not in the air"
        scenario = self.settings.scenario
        segment = current_segment(scenario, self._flight.scenario)
        return "the scenario is flown" if scenario and not isinstance(segment, External) else None

    def _on_setpoint(self, time_us: int, setpoint: PositionSetpoint | AttitudeSetpoint) -> None:
        refusal = self._not_following()
        if refusal is None:
            assert self._flight is not None
            ground, centre = self._flight.scenario.ground, self._centre or (0.0, 0.0)
            refusal = external.refusal(self.settings, setpoint, ground, centre)
        if refusal is not None:
            self._say_not_followed(refusal)
            return
        assert self._flight is not None
        if isinstance(setpoint, AttitudeSetpoint):
            self._external = external.lean(self._external, setpoint, time_us)
            return
        scenario, captured = self._flight.scenario, self._captured
        if self._external is not None:  # since the last step the set point has moved on
            scenario = external.hold(self._external, scenario, captured, time_us)
        x, y = captured[0] + scenario.offset[0], captured[1] + scenario.offset[1]
        here = (x, y, scenario.hold_altitude)
        flight = self.settings.flight
        self._external = external.go_to(flight, self._external, setpoint, here, time_us)

    def _say_not_followed(self, reason: str) -> None:
        begins = "setpoint not followed: "
        if sum(text.startswith(begins) for text in self._said) < MOST_REASONS:
            self._say_once(Severity.WARNING, begins + reason)

    @property
    def _captured(self) -> tuple[float, float]:
        """Where the offset of the set point counts from, m."""
        horizontal = None if self._loop is None else self._loop.horizontal
        return (0.0, 0.0) if horizontal is None else horizontal.captured

    def _follow_setpoints(self, time_us: int) -> None:
        """Move the scenario's hold to where the setpoints from outside want it."""
        if self._external is None:
            return
        if self._not_following() is not None:
            self._external = None
            return
        assert self._flight is not None
        if external.expired(self.settings.flight, self._external, time_us):
            self._external = replace(self._external, attitude=None)
            self._say(Severity.NOTICE, "no attitude setpoints: level")
        moved = external.hold(self._external, self._flight.scenario, self._captured, time_us)
        self._flight = replace(self._flight, scenario=moved)

    def _within_limits(self, time_us: int, directive: Directive) -> Directive:
        """The directive as the guard lets it be followed."""
        assert self._flight is not None
        followed, self._followed = self._followed, None
        if directive.ground_thrust is not None:
            return directive
        ground, (roll, pitch, yaw, altitude) = self._flight.scenario.ground, directive.reference
        held, origin = None, (0.0, 0.0)
        if self.settings.position is not None:
            (x, y), captured = self._centre or (0.0, 0.0), self._captured
            origin = (captured[0] - x, captured[1] - y)
            held = (origin[0] + directive.offset[0], origin[1] + directive.offset[1])
        wish = Wish(roll, pitch, altitude - ground, held)
        before, since_us = (None, time_us) if followed is None or directive.align else followed
        safe, changed = check_wish(self.settings.limits, wish, before, (time_us - since_us) * 1e-6)
        self._followed = (safe, time_us)
        if changed is not None:
            self._say_once(Severity.WARNING, changed)
        if safe == wish:
            return directive
        offset = (
            directive.offset if safe.place is None else (safe.place[0] - origin[0], safe.place[1] - origin[1])
        )
        return replace(
            directive, reference=(safe.roll, safe.pitch, yaw, safe.altitude + ground), offset=offset
        )

    def _with_attitude_setpoint(self, directive: Directive) -> Directive:
        """The directive with the attitude that was asked for from outside."""
        if self._external is None or directive.ground_thrust is not None:
            return directive
        return external.leaning(self.settings, self._external, directive)
