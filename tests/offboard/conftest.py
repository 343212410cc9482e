"""A small vehicle that flies in lock-step with the service: double integrators, modes and arming."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest

from kffa_offboard.control.design import DesignSettings, design
from kffa_offboard.offboard import events
from kffa_offboard.offboard.events import ModeKind
from kffa_offboard.offboard.segments import Hold, Land, Takeoff
from kffa_offboard.offboard.service import Service, State
from kffa_offboard.offboard.settings import ServiceSettings

HOVER = 98.0 / 246.0
GRAVITY = 9.8
TICK_US = 10_000
CUSTOM = {
    ("px4", ModeKind.OFFBOARD): 6 << 16,
    ("px4", ModeKind.HOLD): (4 << 16) | (3 << 24),
    ("px4", ModeKind.LAND): (4 << 16) | (6 << 24),
    ("px4", ModeKind.OTHER): 3 << 16,
    ("ardupilot", ModeKind.OFFBOARD): 4,
    ("ardupilot", ModeKind.HOLD): 17,
    ("ardupilot", ModeKind.LAND): 9,
    ("ardupilot", ModeKind.OTHER): 5,
}
FLIGHT = (Takeoff(2.0, 1.0), Hold(2.0), Land(0.7))


def controller(output="rates", name="ladrc"):
    attitude = output == "attitude"
    return design(
        name,
        DesignSettings(
            b0=np.array(
                [64.0, 64.0, 16.0, GRAVITY / HOVER] if attitude else [12.0, 12.0, 6.0, GRAVITY / HOVER]
            ),
            damping=np.array([13.0, 13.0, 7.0, 0.0] if attitude else [12.0, 12.0, 6.0, 0.0]),
            stiffness=np.array([64.0, 64.0, 16.0, 0.0] if attitude else [0.0] * 4),
            omega_c=np.array([6.0, 6.0, 2.5, 6.0]),
            omega_o=np.array([25.0, 25.0, 10.0, 30.0]),
            lower=np.array([-0.5, -0.5, -10.0, 0.0] if attitude else [-2.0, -2.0, -1.0, 0.0]),
            upper=np.array([0.5, 0.5, 10.0, 1.0] if attitude else [2.0, 2.0, 1.0, 1.0]),
            delay=np.full(4, 0.01),
            trim=np.array([0.0, 0.0, 0.0, HOVER]),
            acceleration=np.array([10.0, 10.0, 3.0, 5.0]),
            omega_c_range=np.array([1.5, 1.5, 0.5, 2.0]),
        ),
    )


CONTROLLERS = {output: controller(output) for output in ("rates", "attitude")}
PAPERS_OWN = controller("rates", "kffa-ladrc")


def service_settings(output="rates", **changes):
    base = ServiceSettings(
        controller=CONTROLLERS[output],
        hover_thrust=HOVER,
        output=output,
        scenario=FLIGHT,
        arm=True,
        engage=True,
    )
    return replace(base, **changes)


@dataclass
class Vehicle:
    """State of the vehicle and the knobs that tests turn."""

    firmware: str = "px4"
    mode: ModeKind = ModeKind.OTHER
    armed: bool = False
    position: float = 0.0
    velocity: float = 0.0
    attitude: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rates: np.ndarray = field(default_factory=lambda: np.zeros(3))
    weight: float = 1.0  # of the loaded vehicle, empty is 1
    own_thrust: float | None = None  # thrust that the autopilot itself applies in flight; None holds height
    grants_mode: bool = True
    grants_arming: bool = True
    answers: bool = True
    reports_target: bool = True
    reports_landed: bool = True
    spool_s: float = 1.0
    armed_us: int = 0
    target: events.AttitudeTarget | None = None
    applied: float = 0.0

    @property
    def grounded(self):
        return bool(self.position <= 1e-6)

    def receive(self, time_us, output):
        """React to one output; answers follow as events."""
        match output:
            case events.AttitudeTarget():
                self.target = output
            case events.SetMode():
                return self.set_mode(output.mode)
            case events.SetArmed():
                return self.set_armed(time_us, output.armed)
            case events.SetGripper():
                return self.answer("gripper", True)
        return []

    def answer(self, action, accepted):
        if not self.answers:
            return []
        return [events.CommandAnswered(action, 0, accepted, False, "ACCEPTED" if accepted else "DENIED")]

    def set_mode(self, mode):
        if self.grants_mode:
            self.mode = mode
        return self.answer("mode", self.grants_mode)

    def set_armed(self, time_us, armed):
        action = "arm" if armed else "disarm"
        if not self.grants_arming or (not armed and not self.grounded):
            return self.answer(action, False)
        if armed and not self.armed:
            self.armed_us = time_us
        self.armed = armed
        return self.answer(action, True)

    def heartbeat(self):
        custom = CUSTOM[self.firmware, self.mode]
        return events.HeartbeatReceived(self.firmware, self.mode, self.mode.value.upper(), custom, self.armed)

    def move(self, time_us, dt):
        """Fly for `dt` seconds under the setpoint or under the autopilot's own control."""
        wanted_rates, thrust = -3.0 * self.attitude, self._own_thrust()
        if self.mode is ModeKind.OFFBOARD and self.target is not None:
            thrust = self.target.thrust
            if self.target.body_rates is not None:
                wanted_rates = np.array(self.target.body_rates)
            else:
                wanted_rates = 6.0 * (np.array(self.target.attitude) - self.attitude)
        if not self.armed or time_us - self.armed_us < self.spool_s * 1e6:
            thrust = 0.0
        self.applied = thrust
        vertical = thrust / HOVER * np.cos(self.attitude[0]) * np.cos(self.attitude[1]) / self.weight
        self.velocity += GRAVITY * (vertical - 1.0) * dt
        self.position += self.velocity * dt
        if self.position <= 0.0:
            self.position, self.velocity = 0.0, max(0.0, self.velocity)
            self.rates = np.zeros(3)
        else:
            self.rates = self.rates + (1.0 - np.exp(-dt / 0.08)) * (wanted_rates - self.rates)
            self.attitude = self.attitude + self.rates * dt

    def _own_thrust(self):
        if not self.armed:
            return 0.0
        if self.mode is ModeKind.LAND:
            return HOVER * (1.0 + (-0.5 - self.velocity) / GRAVITY) if not self.grounded else 0.0
        if self.own_thrust is not None:
            return self.own_thrust
        return HOVER * (1.0 - 2.0 * self.velocity / GRAVITY) if not self.grounded else 0.0


class Lockstep:
    """Service and vehicle, tick by tick; `log` holds every output with its time."""

    def __init__(self, settings, vehicle=None, start_us=5_000_000):
        self.service = Service(settings)
        self.vehicle = vehicle or Vehicle()
        self.time_us = start_us
        self.start_us = start_us
        self.log = []
        self.states = [self.service.state]
        self.altitudes = []
        self.mute = set()  # event classes that do not arrive
        self.change = lambda event: event

    def _take(self, time_us, outputs):
        queue = list(outputs)
        while queue:
            output = queue.pop(0)
            self.log.append((time_us, output))
            for answer in self.vehicle.receive(time_us, output):
                queue.extend(self._handle(answer))
        if self.service.state is not self.states[-1]:
            self.states.append(self.service.state)

    def _handle(self, event):
        if type(event) in self.mute:
            return []
        return self.service.handle(self.time_us, self.change(event))

    def give(self, event):
        """Deliver one event now."""
        self._take(self.time_us, self._handle(event))

    def tick(self):
        """One period of 10 ms."""
        ending = self.time_us + TICK_US
        while (due := self.service.next_deadline()) is not None and due < ending:
            self.time_us = max(due, self.time_us)
            self._take(due, self.service.advance(due))
        self.time_us = ending
        self.vehicle.move(self.time_us, TICK_US * 1e-6)
        self.altitudes.append(self.vehicle.position)
        for event in self._telemetry():
            self.give(event)
        self._take(ending, self.service.advance(ending))  # what follows the last control step

    def _telemetry(self):
        vehicle, now = self.vehicle, self.time_us
        count = (now - self.start_us) // TICK_US
        if count % 100 == 1:
            yield vehicle.heartbeat()
        if count % 20 == 2 and vehicle.reports_landed:
            yield events.LandedStateReported(vehicle.grounded)
        if count % 5 == 0 and vehicle.reports_target:
            yield events.TargetReported(now, vehicle.applied, tuple(vehicle.rates), tuple(vehicle.attitude))
        tiny = 1e-9 * (count % 2)  # no sensor repeats itself to the last bit
        velocity, (p, q, r) = vehicle.velocity, vehicle.rates
        yield events.PositionReceived(now, (0.0, 0.0, vehicle.position), (0.0, tiny, velocity))
        yield events.AttitudeReceived(now, tuple(vehicle.attitude), (p, q, r + tiny))

    def run(self, seconds, until=None):
        """Tick for `seconds`, or until the condition holds; returns whether it came to hold."""
        for _ in range(round(seconds * 1e6 / TICK_US)):
            if until is not None and until():
                return True
            self.tick()
        return until is not None and until()

    def run_to(self, state, seconds=20.0):
        """Tick until the service is in `state`; fails if it does not get there."""
        assert self.run(seconds, lambda: self.service.state is state), (self.service.state, self.texts)
        return self

    def sent(self, kind):
        """Times and outputs of one kind."""
        return [(time, output) for time, output in self.log if isinstance(output, kind)]

    @property
    def texts(self):
        return [output.text for _, output in self.sent(events.Announce)]

    @property
    def thrusts(self):
        """Of every setpoint that was sent."""
        return np.array([target.thrust for _, target in self.sent(events.AttitudeTarget)])


def airborne(**changes):
    """A vehicle that hovers at 3 m under its own control."""
    state = {"mode": ModeKind.HOLD, "armed": True, "position": 3.0, "armed_us": -10_000_000}
    return Vehicle(**(state | changes))


def fly(vehicle=None, output="rates", seconds=60.0, **changes):
    """Fly until the service has finished."""
    flight = Lockstep(service_settings(output, **changes), vehicle)
    flight.run(seconds, lambda: flight.service.finished is not None)
    return flight


def hovering(firmware="px4", **changes):
    """Engaged at 3 m, in a long hold; what was sent until then is forgotten."""
    flight = Lockstep(service_settings(scenario=(Hold(100.0),), **changes), airborne(firmware=firmware))
    flight.run_to(State.ENGAGED)
    flight.run(1.0)
    flight.log.clear()
    return flight


@pytest.fixture(scope="session")
def fake():
    """The names of this file, for tests."""
    return SimpleNamespace(
        Vehicle=Vehicle,
        Lockstep=Lockstep,
        airborne=airborne,
        fly=fly,
        hovering=hovering,
        settings=service_settings,
        hover=HOVER,
        tick_us=TICK_US,
        papers_own=PAPERS_OWN,
    )
