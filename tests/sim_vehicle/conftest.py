"""A pilot for the simulated vehicle: sends MAVLink, keeps what comes back, all in simulated time."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle import airframe
from sim_vehicle.config import build
from sim_vehicle.vehicle import SimulatedVehicle

OFFBOARD = 6
GUIDED = 4
HOVER = 0.3984
STEP_US = 2500


class Pilot:
    """One MAVLink client in lock-step with one vehicle. Links have no delay unless `link` says so."""

    def __init__(self, personality: str, **sections: dict[str, Any]) -> None:
        sections.setdefault("vehicle", {})
        sections["vehicle"] = {
            "personality": personality,
            "attitude_ready_s": 0.0,
            "position_ready_s": 0.0,
            **sections["vehicle"],
        }
        sections.setdefault("link", {"telemetry_delay_s": 0.0, "command_delay_s": 0.0})
        self.personality = personality
        self.vehicle = SimulatedVehicle(build(sections, "test"))
        self.codec = mavlink.MAVLink(file=None, srcSystem=255, srcComponent=190)
        self.codec.robust_parsing = True
        self.received: list[tuple[float, Any]] = []
        self.bytes = b""

    # ------------------------------------------------------------------------------- talking

    def send(self, message: Any, key: str = "pilot") -> None:
        self.vehicle.receive(bytes(message.pack(self.codec)), key)
        self.codec.seq = (self.codec.seq + 1) % 256

    def command(self, number: int, *parameters: float, system: int = 1) -> None:
        values = [*parameters, *[0.0] * (7 - len(parameters))]
        self.send(mavlink.MAVLink_command_long_message(system, 1, number, 0, *values))

    def ask(self, number: int, *parameters: float, wait: float = 0.1) -> int | None:
        """Result of a command, or None if no answer comes."""
        mark = len(self.received)
        self.command(number, *parameters)
        self.run(wait)
        answers = [m.result for _, m in self.received[mark:] if m.get_type() == "COMMAND_ACK"]
        return answers[0] if answers else None

    def setpoint(
        self,
        mask: int = 128,
        rates: tuple[float, float, float] = (0.0, 0.0, 0.0),
        thrust: float = HOVER,
        attitude: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0),
    ) -> None:
        """SET_ATTITUDE_TARGET with MAVLink's own signs."""
        self.send(mavlink.MAVLink_set_attitude_target_message(0, 1, 1, mask, list(attitude), *rates, thrust))

    def run(self, seconds: float, each: Callable[[], None] | None = None, every: float = 0.01) -> None:
        """Let time pass; `each` is called every `every` seconds, first at once."""
        end = self.vehicle.time_us + round(seconds * 1e6)
        stride = round(every * 1e6)
        while self.vehicle.time_us < end:
            if each is not None:
                each()
            self.vehicle.advance(min(end, self.vehicle.time_us + stride))
            self.collect()

    def collect(self) -> None:
        for _, data in self.vehicle.outgoing():
            self.bytes += data
            now = self.vehicle.time_us * 1e-6
            self.received += [(now, message) for message in self.codec.parse_buffer(data) or []]

    # ------------------------------------------------------------------------------- hearing

    def messages(self, kind: str, since: float = 0.0) -> list[Any]:
        return [m for time, m in self.received if m.get_type() == kind and time > since]

    def times(self, kind: str, since: float = 0.0) -> list[float]:
        return [time for time, m in self.received if m.get_type() == kind and time > since]

    def texts(self) -> list[str]:
        return [message.text for message in self.messages("STATUSTEXT")]

    def results(self, number: int) -> list[int]:
        return [m.result for m in self.messages("COMMAND_ACK") if m.command == number]

    @property
    def now(self) -> float:
        return self.vehicle.time_us * 1e-6

    @property
    def mode(self) -> str:
        return self.vehicle.firmware.mode_name

    @property
    def height(self) -> float:
        return float(self.vehicle.state.rigid[2])

    # -------------------------------------------------------------------------------- flying

    def arm(self, mode: int = GUIDED) -> None:
        if self.personality == "ardupilot":
            assert self.ask(mavlink.MAV_CMD_DO_SET_MODE, 1, mode) == mavlink.MAV_RESULT_ACCEPTED
        assert self.ask(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1) == mavlink.MAV_RESULT_ACCEPTED

    def engage(self, mode: int = GUIDED) -> None:
        """Armed and obeying setpoints, still on the ground."""
        if self.personality == "px4":
            self.run(0.3, self.setpoint)
            self.command(mavlink.MAV_CMD_DO_SET_MODE, 1, OFFBOARD)
            self.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
            self.run(0.1, self.setpoint)
        else:
            self.arm(mode)
            self.run(2.7, self.setpoint)
        assert self.vehicle.firmware.armed

    def place(self, height: float = 20.0) -> None:
        """Put the vehicle into level hover at `height`, whatever it did before."""
        rigid = np.zeros(12)
        rigid[2] = height
        self.vehicle.state = airframe.AirframeState(
            rigid, np.full(4, 0.25 * self.vehicle.body.base_mass * 9.8), 0.0, 0.0, False
        )

    def engage_in_flight(self, mode: int = GUIDED, height: float = 20.0) -> None:
        """Hovering at `height` and obeying body-rate setpoints."""
        self.engage(mode)
        self.place(height)
        self.run(0.3, self.setpoint)
        assert not self.vehicle.firmware.land.landed

    def take_off(self, height: float = 2.5) -> None:
        """By the autopilot's own takeoff, until it holds."""
        self.arm()
        altitude = math.nan if self.personality == "px4" else height
        assert self.ask(mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, altitude) == 0
        self.run(8.0)

    def peak_after(self, mass_kg: float, seconds: float) -> float:
        """Largest height error after the load became `mass_kg`."""
        before, mark = self.height, len(self.vehicle.truth.rows)
        self.vehicle.set_load(mass_kg)
        self.run(seconds)
        return max(abs(row.state[2] - before) for row in self.vehicle.truth.rows[mark:])

    def rise_times(self, axis: int, levels: tuple[float, ...]) -> list[float]:
        """When the true body rate first reaches `levels` [rad/s] after a step to 1 rad/s, in s."""
        rates = [0.0, 0.0, 0.0]
        rates[axis] = 1.0
        sign = 1.0 if axis == 0 else -1.0
        start, reached = self.now, [math.nan] * len(levels)
        for step in range(600):
            if step % 4 == 0:
                self.setpoint(rates=(rates[0], rates[1], rates[2]))
            self.vehicle.advance(self.vehicle.time_us + STEP_US)
            rate = sign * float(self.vehicle.state.rigid[9 + axis])
            for index, level in enumerate(levels):
                if math.isnan(reached[index]) and rate >= level:
                    reached[index] = self.now - start
            if not any(math.isnan(time) for time in reached):
                break
        return reached


@pytest.fixture
def make_pilot() -> Callable[..., Pilot]:
    return Pilot


@pytest.fixture
def px4() -> Pilot:
    return Pilot("px4")


@pytest.fixture
def copter() -> Pilot:
    """ArduCopter whose SET_ATTITUDE_TARGET carries thrust."""
    return Pilot("ardupilot", parameters={"GUID_OPTIONS": 8, "ATC_ANGLE_BOOST": 0})
