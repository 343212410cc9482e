"""The control step in the service: what it is to do, the setpoint, and afterwards what others learn of it.

Part of the offboard service, beside `session.py` and `service.py`.
"""

from __future__ import annotations

from collections.abc import Mapping

from kffa_offboard.control import controllers, payload
from kffa_offboard.control.plain import Vector
from kffa_offboard.offboard import echo, telemetry
from kffa_offboard.offboard.events import Severity, TargetReported
from kffa_offboard.offboard.flight import AIR, Directive, FlightSample, begin_flight, step_flight
from kffa_offboard.offboard.loop import LoopStep, Order, signals, step_loop
from kffa_offboard.offboard.request_session import RequestSession
from kffa_offboard.offboard.sequence import EngagePhase, microseconds, mode_granted
from kffa_offboard.offboard.settings import ServiceSettings
from kffa_offboard.offboard.state import ENGAGED, ENGAGING, RELEASING, SENDING
from kffa_offboard.offboard.swinging import for_swinging_load

SWINGS = "the load swings: damping it"


def write_out(settings: ServiceSettings) -> None:
    """Do before the first sample what takes longest in the first steps: `control.straight`."""
    controllers.write_out(settings.controller, with_rate=True)
    if settings.position is not None:
        controllers.write_out(settings.position.ring.controller, with_rate=True)
        controllers.write_out(for_swinging_load(settings).controller, with_rate=True)
    if settings.payload is not None:
        payload.write_out(settings.payload.estimator)


class ControlSession(RequestSession):
    """The part of the service that makes control steps; use `service.Service`."""

    __slots__ = ()

    def __init__(self, settings: ServiceSettings) -> None:
        super().__init__(settings)
        write_out(settings)
        self._flown: Mapping[int, Vector] = {}
        self._stepped: tuple[Order, LoopStep] | None = None

    def _control(self, time_us: int, dt: float) -> None:
        """One control step, in shadow or in earnest; the only source of new setpoints."""
        assert self._loop is not None
        order = self._order(time_us)
        self._loop, result = step_loop(
            self.settings, self._loop, self._known, order, time_us, dt, flown=self._flown.get(time_us)
        )
        if order.sending and result.target is not None:
            self._outputs.append(result.target)
            self._echo = echo.send(self._echo, time_us, result.target.thrust)
        self._stepped = order, result
        if self._loop.swings and SWINGS not in self._said:
            self._say_once(Severity.WARNING, SWINGS)
            self._retune(self.settings)
        if result.fault is not None:
            self._fault(time_us, result.fault)
            return
        if order.sending:
            for action in order.directive.gripper:
                self._work_gripper(time_us, action, dt)
        if self.state is ENGAGED and order.directive.ending is not None:
            self._end_flight(time_us, order.directive.ending, order.directive.reason)

    def _watch_echo(self, time_us: int, reported: TargetReported) -> None:
        """Somebody else's setpoints that we do not see may show in what the autopilot says it follows."""
        flies = self.state is ENGAGED and self._flight is not None and self._flight.phase is AIR
        if not flies or reported.thrust is None:
            self._echo = echo.forget_reports(self._echo)
            return
        self._echo, others = echo.report(self._echo, time_us, reported.thrust)
        if others:
            self._say_once(Severity.WARNING, "somebody else's setpoints reach the vehicle")

    def _follow_step(self, time_us: int) -> None:
        """What a control step means to those who watch, once its setpoint is on the way: log and load."""
        assert self._stepped is not None
        (order, result), self._stepped = self._stepped, None
        latency_s = telemetry.latency_s(self._known, self._link, time_us)
        self._outputs.append(signals(result.trace, order.state_name, latency_s))
        if result.fault is None:
            self._watch_payload(time_us, result.trace, order)

    def _order(self, time_us: int) -> Order:
        """What this step is to do in the present state."""
        if self.state not in SENDING:
            return Order(self._level_here(), self.state._value_)
        assert self._flight is not None
        if self.state is ENGAGING:
            return self._order_engaging(time_us)
        grounded = self.state is RELEASING and self._flight.phase is not AIR
        if grounded:
            directive = self._idle()
        else:
            segments = self.settings.scenario if self.state is ENGAGED else ()
            self._follow_setpoints(time_us)
            self._flight, directive = step_flight(
                self.settings, segments, self._flight, self._flight_sample(time_us)
            )
            directive = self._within_limits(time_us, self._with_attitude_setpoint(directive))
        airborne = directive.ground_thrust is None
        return Order(directive, self.state._value_, sending=True, acting=True, airborne=airborne)

    def _order_engaging(self, time_us: int) -> Order:
        assert self._flight is not None and self._engagement is not None
        name = self.state._value_
        if self._engagement.grounded:
            return Order(self._idle(), name, sending=True, acting=True)
        capture = self._engagement.phase is EngagePhase.STREAM or self._capture
        self._capture = False
        if capture:
            here = self._level_here()
            self._flight = begin_flight(time_us, True, here.reference[3], here.reference[2])
        scenario = self._flight.scenario
        reference = (0.0, 0.0, scenario.yaw, scenario.hold_altitude)
        acting = mode_granted(self._engagement)
        directive = Directive(reference, align=capture)
        return Order(directive, name, sending=True, acting=acting, capture=capture, airborne=True)

    def _level_here(self) -> Directive:
        """Stay here: what the controller would want if it were engaged now."""
        assert self._known.attitude is not None and self._loop is not None
        return Directive((0.0, 0.0, self._known.attitude.attitude[2], self._loop.hold_altitude), align=True)

    def _idle(self) -> Directive:
        """On the ground, no thrust."""
        assert self._flight is not None
        scenario = self._flight.scenario
        return Directive((0.0, 0.0, scenario.yaw, scenario.hold_altitude), ground_thrust=0.0, align=True)

    def _flight_sample(self, time_us: int) -> FlightSample:
        known, loop = self._known, self._loop
        assert known.position is not None and loop is not None
        powered_us = None
        if known.armed_since_us is not None and known.heartbeat is not None:
            flight = self.settings.flight
            px4 = known.heartbeat.firmware == "px4"
            spool_s = flight.px4_spool_time_s if px4 else flight.ardupilot_spool_time_s
            powered_us = known.armed_since_us + microseconds(spool_s)
        return FlightSample(
            time_us=time_us,
            altitude=loop.altitude,
            climb_rate=known.position.velocity[2],
            thrust=loop.sent.thrust if loop.sent is not None else 0.0,
            vertical_thrust=loop.vertical_thrust,
            on_ground=known.on_ground,
            powered_us=powered_us,
        )
