"""Flight mode numbers of both firmwares, as they stand in `custom_mode` of HEARTBEAT."""

from __future__ import annotations

from enum import IntEnum


class FlightMode(IntEnum):
    """A flight mode of either firmware."""

    @property
    def label(self) -> str:
        """What the firmware's users call it."""
        return self.name


class Px4Mode(FlightMode):
    """PX4 (px4_custom_mode.h): main mode << 16 | sub mode << 24."""

    MANUAL = 1 << 16
    ALTCTL = 2 << 16
    POSCTL = 3 << 16
    TAKEOFF = 4 << 16 | 2 << 24
    LOITER = 4 << 16 | 3 << 24
    MISSION = 4 << 16 | 4 << 24
    RTL = 4 << 16 | 5 << 24
    LAND = 4 << 16 | 6 << 24
    ACRO = 5 << 16
    OFFBOARD = 6 << 16
    STABILIZED = 7 << 16

    @property
    def label(self) -> str:
        """What PX4's users call it."""
        return {"LOITER": "HOLD", "POSCTL": "POSITION", "ALTCTL": "ALTITUDE"}.get(self.name, self.name)


class CopterMode(FlightMode):
    """ArduCopter (mode.h), the modes that this simulator knows."""

    STABILIZE = 0
    ALT_HOLD = 2
    AUTO = 3
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17
    GUIDED_NOGPS = 20
