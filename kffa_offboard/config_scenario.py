"""The `[scenario]` table: what is flown after engaging, segment by segment (`offboard/segments.py`)."""

from __future__ import annotations

from math import radians
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kffa_offboard.config_control import Table
from kffa_offboard.config_units import number
from kffa_offboard.offboard import segments

Length = Annotated[float, number("m", above=0.0, at_most=1000.0)]
Speed = Annotated[float, number("m/s", above=0.0, at_most=50.0)]


class TakeoffTable(Table):
    """Climb to `altitude_m`."""

    type: Literal["takeoff"]
    altitude_m: Length = Field(description="the altitude to climb to")
    climb_rate_m_s: Speed = 1.0

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Takeoff(self.altitude_m, self.climb_rate_m_s)


class AltitudeTable(Table):
    """Climb or descend to `altitude_m`, in the air."""

    type: Literal["altitude"]
    altitude_m: Length = Field(description="the altitude to go to")
    speed_m_s: Speed = 1.0

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Altitude(self.altitude_m, self.speed_m_s)


class HoldTable(Table):
    """Stay, level, for `duration_s`."""

    type: Literal["hold"]
    duration_s: Annotated[float, number("s", above=0.0)] = Field(description="how long to hold")

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Hold(self.duration_s)


class ExternalTable(Table):
    """Hold for `duration_s` and follow setpoints from outside meanwhile."""

    type: Literal["external"]
    duration_s: Annotated[float, number("s", above=0.0)] = Field(description="how long to follow them")

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.External(self.duration_s)


class WaveTable(Table):
    """What steps, triangles and sines share: a channel and an amplitude in its unit."""

    channel: segments.Channel = Field(description='the channel: "roll", "pitch", "yaw" or "altitude"')
    amplitude_m: Annotated[float | None, number("m", at_least=-100.0, at_most=100.0)] = None
    amplitude_deg: Annotated[float | None, number("deg", at_least=-180.0, at_most=180.0)] = None

    @model_validator(mode="after")
    def _amplitude_fits(self) -> WaveTable:
        wanted, other = (
            ("amplitude_m", "amplitude_deg")
            if self.channel == "altitude"
            else ("amplitude_deg", "amplitude_m")
        )
        if getattr(self, wanted) is None or getattr(self, other) is not None:
            raise ValueError(f'channel = "{self.channel}" needs {wanted}, and not {other}')
        return self

    @property
    def amplitude(self) -> float:
        """Amplitude in rad or m."""
        if self.amplitude_m is not None:
            return self.amplitude_m
        assert self.amplitude_deg is not None
        return radians(self.amplitude_deg)


class StepTable(WaveTable):
    """Step a channel for `duration_s`."""

    type: Literal["step"]
    duration_s: Annotated[float, number("s", above=0.0)] = Field(description="how long the step lasts")

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Step(self.channel, self.amplitude, self.duration_s)


class PeriodicTable(WaveTable):
    """What triangles and sines share."""

    period_s: Annotated[float, number("s", above=0.0)] = Field(description="the period")
    cycles: Annotated[float, number(above=0.0, at_most=1000.0)] = 1.0


class TriangleTable(PeriodicTable):
    """Triangular wave on a channel."""

    type: Literal["triangle"]

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Triangle(self.channel, self.amplitude, self.period_s, self.cycles)


class SineTable(PeriodicTable):
    """Sine wave on a channel."""

    type: Literal["sine"]

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Sine(self.channel, self.amplitude, self.period_s, self.cycles)


class MoveTable(Table):
    """Go north and east of the present set point; needs `[position]`."""

    type: Literal["move"]
    north_m: Annotated[float, number("m", at_least=-10000.0, at_most=10000.0)] = 0.0
    east_m: Annotated[float, number("m", at_least=-10000.0, at_most=10000.0)] = 0.0
    duration_s: Annotated[float, number("s", above=0.0)] = Field(
        description="how long the move lasts, with the rest after it"
    )
    speed_m_s: Speed = 2.0

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Move(self.north_m, self.east_m, self.duration_s, self.speed_m_s)


class GripperTable(Table):
    """Work the gripper."""

    type: Literal["gripper"]
    action: Literal["grab", "release"] = Field(description='"grab" or "release"')

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Gripper(self.action)


class LandTable(Table):
    """Descend to the ground."""

    type: Literal["land"]
    descent_rate_m_s: Speed = 0.7

    def segment(self) -> segments.Segment:
        """The segment that the service flies."""
        return segments.Land(self.descent_rate_m_s)


SegmentTable = Annotated[
    TakeoffTable
    | AltitudeTable
    | HoldTable
    | ExternalTable
    | StepTable
    | TriangleTable
    | SineTable
    | MoveTable
    | GripperTable
    | LandTable,
    Field(discriminator="type"),
]


class ScenarioTable(Table):
    """`[scenario]`: what is flown after engaging; without segments, hold until released."""

    segment: list[SegmentTable] = Field(default_factory=list)
