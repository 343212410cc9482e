"""The scripted ground station: what it asks for, in which order, and what it says when it is refused."""

from __future__ import annotations

import math

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.compare.pilot import Phase, Pilot
from kffa_offboard.compare.plan import AutopilotName
from kffa_offboard.mavlink.component import Component, FrameParser, Message, Route
from kffa_offboard.mavlink.transport import Datagram
from kffa_offboard.trials.metrics import FlightFailed

VEHICLE = Component(Route(own_system=3, own_component=1))
LOITER, GUIDED = 3 << 24 | 4 << 16, 4


class Vehicle:
    """A vehicle that does what it is told, unless `refuses`."""

    def __init__(self, autopilot: str, refuses: str = "", counts_from_ground: bool = False) -> None:
        name: AutopilotName = "px4" if autopilot == "px4" else "ardupilot"
        self.pilot = Pilot(name, 3, 5.0, 10.0, counts_from_ground)
        self.hold = LOITER if autopilot == "px4" else GUIDED
        self.refuses = refuses
        self.time_s, self.mode, self.armed, self.height = 0.0, 0, False, 0.0
        self.asked: list[Message] = []
        self.origin_mm = 488_000

    def say(self, message: Message) -> None:
        frame = Datagram(0, VEHICLE.pack(message), None)
        for parsed in FrameParser(keeps_frames_whole=True).parse(frame):
            for answer in self.pilot.handle(parsed):
                self.take(answer)

    def take(self, message: Message) -> None:
        if message.get_type() == "SET_GPS_GLOBAL_ORIGIN":
            self.origin_mm = message.altitude
        if message.get_type() != "COMMAND_LONG":
            return
        self.asked.append(message)
        match message.command:
            case mavlink.MAV_CMD_DO_SET_MODE:
                px4 = self.hold == LOITER
                sub, main = int(message.param3), int(message.param2)
                self.mode = sub << 24 | main << 16 if px4 else main
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM if self.refuses:
                self.say(mavlink.MAVLink_statustext_message(4, self.refuses.encode(), 0, 0))
            case mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = True
            case mavlink.MAV_CMD_NAV_TAKEOFF:
                self.height = 5.0

    def second(self) -> None:
        self.time_s += 1.0
        landing = self.mode not in (0, self.hold)
        if landing:
            self.height, self.armed = 0.0, False
        now = round(self.time_s * 1000)
        base = 128 if self.armed else 0
        self.say(mavlink.MAVLink_heartbeat_message(2, 12, base, self.mode, 3, 3))
        altitude = self.origin_mm + round(self.height * 1000)
        fix = mavlink.MAVLink_gps_raw_int_message(0, 3, 473977420, 85455940, 488_000, 0, 0, 0, 0, 9)
        self.say(fix)
        self.say(mavlink.MAVLink_global_position_int_message(now, 0, 0, altitude, 0, 0, 0, 0, 0))
        self.say(mavlink.MAVLink_local_position_ned_message(now, 0.0, 0.0, -self.height, 0.0, 0.0, 0.0))
        self.say(mavlink.MAVLink_attitude_message(now, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))

    def commands(self) -> list[int]:
        return [message.command for message in self.asked]


@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_it_takes_off_holds_lands_and_is_done(autopilot: str) -> None:
    vehicle = Vehicle(autopilot)
    for _ in range(40):
        vehicle.second()
    assert vehicle.pilot.phase is Phase.DONE
    flown = [
        command
        for command in vehicle.commands()
        if command
        in (
            mavlink.MAV_CMD_DO_SET_MODE,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
            mavlink.MAV_CMD_NAV_TAKEOFF,
        )
    ]
    assert flown == [
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_COMPONENT_ARM_DISARM,
        mavlink.MAV_CMD_NAV_TAKEOFF,
        mavlink.MAV_CMD_DO_SET_MODE,
    ]


def test_px4_is_given_the_height_above_sea_level_and_arducopter_above_ground() -> None:
    heights = {}
    for autopilot in ("px4", "ardupilot"):
        vehicle = Vehicle(autopilot)
        for _ in range(10):
            vehicle.second()
        (takeoff,) = (m for m in vehicle.asked if m.command == mavlink.MAV_CMD_NAV_TAKEOFF)
        heights[autopilot] = (takeoff.param7, math.isnan(takeoff.param5))
    assert heights == {"px4": (493.0, True), "ardupilot": (5.0, False)}


def test_arming_that_is_refused_for_too_long_ends_with_the_vehicles_reason() -> None:
    vehicle = Vehicle("ardupilot", refuses="PreArm: Gyros inconsistent")
    with pytest.raises(FlightFailed, match="could not be armed within 120 s: PreArm: Gyros inconsistent"):
        for _ in range(200):
            vehicle.second()


def test_an_estimate_that_counts_from_the_ground_is_told_its_height_above_the_sea_before_arming() -> None:
    vehicle = Vehicle("px4", counts_from_ground=True)
    vehicle.origin_mm, vehicle.height = 0, 0.2
    for _ in range(4):
        vehicle.second()
    assert vehicle.origin_mm == 487_800
    assert mavlink.MAV_CMD_COMPONENT_ARM_DISARM in vehicle.commands()


def test_an_estimate_that_is_not_told_to_count_from_the_ground_keeps_its_origin() -> None:
    vehicle = Vehicle("px4")
    vehicle.origin_mm = 400_000
    for _ in range(4):
        vehicle.second()
    assert vehicle.origin_mm == 400_000
