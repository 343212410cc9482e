"""The tables of a configuration beside `[control]`, as pydantic reads them.

Most keys are the fields of the frozen records in `offboard/settings.py`, whose docstrings say what they
mean, and take their defaults from there. Degrees are accepted here only, in keys that end in `_deg`, `_deg_s`
or `_deg_s2`.
"""

from __future__ import annotations

from math import degrees
from typing import Annotated, Literal

from pydantic import Field, model_validator

from kffa_offboard.config_control import ControlTable, Table
from kffa_offboard.config_link import CompanionTable, FileName, LinkTable, SigningTable
from kffa_offboard.config_payload import PayloadTable
from kffa_offboard.config_position import PositionTable
from kffa_offboard.config_process import ProcessTable, RealtimeTable
from kffa_offboard.config_scenario import ScenarioTable
from kffa_offboard.config_units import number
from kffa_offboard.offboard.settings import (
    FailsafeAction,
    FlightSettings,
    LimitSettings,
    SequenceSettings,
    TelemetrySettings,
)

_TELEMETRY = TelemetrySettings()
_LIMITS = LimitSettings()
_SEQUENCE = SequenceSettings()
_FLIGHT = FlightSettings()

Rate = Annotated[float, number("Hz", above=0.0, at_most=1000.0)]
Timeout = Annotated[float, number("s", above=0.0, at_most=30.0)]
# Meanwhile the last setpoint is flown on: in 3 s the simulated vehicle rises by 6 m, in 6 s by 27 m.
Blind = Annotated[float, number("s", above=0.0, at_most=3.0)]
LongTimeout = Annotated[float, number("s", above=0.0, at_most=600.0)]
Interval = Annotated[float, number("s", at_least=0.01, at_most=10.0)]
Length = Annotated[float, number("m", above=0.0, at_most=1000.0)]
Altitude = Annotated[float, number("m", at_least=-1000.0, at_most=10000.0)]
Speed = Annotated[float, number("m/s", above=0.0, at_most=50.0)]
Thrust = Annotated[float, number("of full thrust", at_least=0.0, at_most=1.0)]
Fraction = Annotated[float, number(above=0.0, at_most=1.0)]
Angle = Annotated[float, number("deg", at_least=3.0, at_most=180.0)]
AngularRate = Annotated[float, number("deg/s", at_least=10.0, at_most=2000.0)]


class TelemetryTable(Table):
    """`[telemetry]`: `offboard.settings.TelemetrySettings`, and how long to wait for a vehicle.

    `barrier_timeout_s` is in lock-step: wall time that the vehicle may take to its next barrier.
    """

    connect_timeout_s: LongTimeout = 10.0
    barrier_timeout_s: LongTimeout = 5.0
    attitude_hz: Rate = _TELEMETRY.attitude_hz
    position_hz: Rate = _TELEMETRY.position_hz
    target_hz: Rate = _TELEMETRY.target_hz
    status_hz: Rate = _TELEMETRY.status_hz
    heartbeat_hz: Rate = _TELEMETRY.heartbeat_hz
    minimum_attitude_hz: Rate = _TELEMETRY.minimum_attitude_hz
    minimum_position_hz: Rate = _TELEMETRY.minimum_position_hz
    rate_fraction: Fraction = _TELEMETRY.rate_fraction
    timeout_s: Blind = _TELEMETRY.timeout_s
    position_timeout_s: Blind = _TELEMETRY.position_timeout_s
    heartbeat_timeout_s: Timeout = _TELEMETRY.heartbeat_timeout_s
    settle_time_s: Timeout = _TELEMETRY.settle_time_s
    request_interval_s: Timeout = _TELEMETRY.request_interval_s
    request_limit: Annotated[int, Field(ge=1, le=1000)] = _TELEMETRY.request_limit
    report_timeout_s: Timeout = _TELEMETRY.report_timeout_s
    repeated_samples_max: Annotated[int, Field(ge=1, le=10000)] = _TELEMETRY.repeated_samples_max
    frozen_time_s: Timeout = _TELEMETRY.frozen_time_s
    late_max_s: Timeout = _TELEMETRY.late_max_s
    estimate_invalid_s: Timeout = _TELEMETRY.estimate_invalid_s


class LimitsTable(Table):
    """`[limits]`: `offboard.settings.LimitSettings`, angles in degrees."""

    tilt_max_deg: Angle = degrees(_LIMITS.tilt_max_rad)
    roll_rate_max_deg_s: AngularRate = degrees(_LIMITS.body_rate_max_rad_s[0])
    pitch_rate_max_deg_s: AngularRate = degrees(_LIMITS.body_rate_max_rad_s[1])
    yaw_rate_max_deg_s: AngularRate = degrees(_LIMITS.body_rate_max_rad_s[2])
    body_rate_change_max_deg_s2: Annotated[float, number("deg/s^2", at_least=100.0, at_most=1e6)] = degrees(
        _LIMITS.body_rate_change_max_rad_s2
    )
    thrust_min: Thrust = _LIMITS.thrust_min
    thrust_max: Thrust = _LIMITS.thrust_max
    thrust_rate_max_per_s: Annotated[float, number("1/s", above=0.0, at_most=1000.0)] = (
        _LIMITS.thrust_rate_max_per_s
    )
    tilt_failsafe_deg: Angle = degrees(_LIMITS.tilt_failsafe_rad)
    altitude_min_m: Altitude = _LIMITS.altitude_min_m
    altitude_max_m: Altitude = _LIMITS.altitude_max_m
    climb_rate_setpoint_max_m_s: Speed = _LIMITS.climb_rate_setpoint_max_m_s
    attitude_jump_deg: Angle = degrees(_LIMITS.attitude_jump_rad)
    attitude_rate_max_deg_s: AngularRate = degrees(_LIMITS.attitude_rate_max_rad_s)
    altitude_jump_m: Length = _LIMITS.altitude_jump_m
    climb_rate_max_m_s: Speed = _LIMITS.climb_rate_max_m_s
    fence_radius_m: Annotated[float, number("m", at_least=1.0, at_most=1e5)] = _LIMITS.fence_radius_m
    battery_min_percent: Annotated[float, number("%", at_least=0.0, at_most=100.0)] = (
        _LIMITS.battery_min_percent
    )
    tilt_compensation_max_deg: Angle = degrees(_LIMITS.tilt_compensation_max_rad)


class SequenceTable(Table):
    """`[sequence]`: `offboard.settings.SequenceSettings`."""

    stream_time_s: Interval = _SEQUENCE.stream_time_s
    mode_retry_s: Interval = _SEQUENCE.mode_retry_s
    mode_timeout_s: Timeout = _SEQUENCE.mode_timeout_s
    arm_retry_s: Interval = _SEQUENCE.arm_retry_s
    arm_timeout_s: LongTimeout = _SEQUENCE.arm_timeout_s
    person_arm_timeout_s: LongTimeout = _SEQUENCE.person_arm_timeout_s
    hold_retry_s: Interval = _SEQUENCE.hold_retry_s
    hold_timeout_s: Timeout = _SEQUENCE.hold_timeout_s
    disarm_retry_s: Interval = _SEQUENCE.disarm_retry_s
    disarm_timeout_s: LongTimeout = _SEQUENCE.disarm_timeout_s
    confirm_grace_s: Interval = _SEQUENCE.confirm_grace_s
    gripper_timeout_s: Timeout = _SEQUENCE.gripper_timeout_s
    resend_s: Annotated[float, number("s", at_least=0.01, at_most=0.5)] = _SEQUENCE.resend_s
    own_heartbeat_s: Interval = _SEQUENCE.own_heartbeat_s
    blend_time_s: Interval = _SEQUENCE.blend_time_s


class FlightTable(Table):
    """`[flight]`: `offboard.settings.FlightSettings`."""

    px4_spool_time_s: Annotated[float, number("s", at_least=0.0, at_most=30.0)] = _FLIGHT.px4_spool_time_s
    ardupilot_spool_time_s: Annotated[float, number("s", at_least=0.0, at_most=30.0)] = (
        _FLIGHT.ardupilot_spool_time_s
    )
    ramp_rate_per_s: Annotated[float, number("1/s", above=0.0, at_most=10.0)] = _FLIGHT.ramp_rate_per_s
    # Until lift-off is noticed thrust grows without anybody holding the height.
    liftoff_climb_rate_m_s: Annotated[float, number("m/s", above=0.0, at_most=1.0)] = (
        _FLIGHT.liftoff_climb_rate_m_s
    )
    liftoff_height_m: Annotated[float, number("m", above=0.0, at_most=0.5)] = _FLIGHT.liftoff_height_m
    liftoff_thrust_fraction: Fraction = _FLIGHT.liftoff_thrust_fraction
    liftoff_timeout_s: Timeout = _FLIGHT.liftoff_timeout_s
    acceleration_m_s2: Annotated[float, number("m/s^2", above=0.0, at_most=50.0)] = _FLIGHT.acceleration_m_s2
    arrival_tolerance_m: Length = _FLIGHT.arrival_tolerance_m
    arrival_time_s: Timeout = _FLIGHT.arrival_time_s
    arrival_timeout_s: LongTimeout = _FLIGHT.arrival_timeout_s
    slow_height_m: Length = _FLIGHT.slow_height_m
    slow_descent_rate_m_s: Annotated[float, number("m/s", above=0.0, at_most=2.0)] = (
        _FLIGHT.slow_descent_rate_m_s
    )
    # With less the descent creeps: the reference that it follows is late by twice the reference filter.
    landing_lead_m: Annotated[float, number("m", at_least=0.1, at_most=1000.0)] = _FLIGHT.landing_lead_m
    # Beyond these a vehicle that hangs in the air on less thrust than expected looks like one that stands.
    touchdown_thrust_fraction: Annotated[float, number(above=0.0, at_most=0.8)] = (
        _FLIGHT.touchdown_thrust_fraction
    )
    touchdown_climb_rate_m_s: Annotated[float, number("m/s", above=0.0, at_most=0.5)] = (
        _FLIGHT.touchdown_climb_rate_m_s
    )
    touchdown_time_s: Annotated[float, number("s", at_least=0.1, at_most=30.0)] = _FLIGHT.touchdown_time_s
    touchdown_ramp_s: Interval = _FLIGHT.touchdown_ramp_s
    setpoint_speed_m_s: Speed = _FLIGHT.setpoint_speed_m_s
    setpoint_climb_rate_m_s: Speed = _FLIGHT.setpoint_climb_rate_m_s
    setpoint_timeout_s: Timeout = _FLIGHT.setpoint_timeout_s


class FailsafeTable(Table):
    """`[failsafe]`: what happens when the daemon gives up control.

    "stop" sends no more, so that the autopilot's own loss-of-offboard action runs (ArduCopter has none but to
    stay level in GUIDED, and drifts); "hold" and "land" ask for that mode first.
    """

    action: FailsafeAction = "stop"


class AutopilotTable(Table):
    """`[autopilot]`: what is done with the autopilot's own parameters, and which mode of ArduPilot flies."""

    check_parameters: bool = True
    fix_parameters: bool = False
    ardupilot_mode: Literal["guided", "guided_nogps"] = "guided"

    @model_validator(mode="after")
    def _fixing_needs_checking(self) -> AutopilotTable:
        if self.fix_parameters and not self.check_parameters:
            raise ValueError("fix_parameters = true needs check_parameters = true")
        return self


class LogTable(Table):
    """`[log]`: where flight logs go; left out, none is kept."""

    directory: FileName | None = None
    file_size_max_mb: Annotated[float | None, number(at_least=1.0, at_most=1e6)] = None
    """A longer flight goes on in FLIGHT-2.tlog, FLIGHT-3.tlog, ...; an hour at 100 Hz is about 200 MB."""


class ParametersTable(Table):
    """`[parameters]`: where values that were changed in flight are stored, beside the configuration.

    Left out, they cannot be stored. At the next start the file is read on top of the configuration.
    """

    file: FileName | None = None


class SignalsTable(Table):
    """`[signals]`: how often the inner signals go out for ground stations; 0 for never.

    `vector` is the channel that DEBUG_VECT has, left out for none.
    """

    rate_hz: Annotated[float, number("Hz", at_least=0.0, at_most=500.0)] = 10.0
    vector: Literal["roll", "pitch", "yaw", "altitude"] | None = None


class ConfigFile(Table):
    """A whole configuration file."""

    link: LinkTable = Field(description="the table [link] with at least url")
    signing: SigningTable = SigningTable()
    companion: CompanionTable = CompanionTable()
    telemetry: TelemetryTable = TelemetryTable()
    control: ControlTable = Field(description="the table [control] with [control.altitude] hover_thrust")
    limits: LimitsTable = LimitsTable()
    sequence: SequenceTable = SequenceTable()
    flight: FlightTable = FlightTable()
    position: PositionTable = PositionTable()
    payload: PayloadTable = PayloadTable()
    failsafe: FailsafeTable = FailsafeTable()
    autopilot: AutopilotTable = AutopilotTable()
    scenario: ScenarioTable = ScenarioTable()
    parameters: ParametersTable = ParametersTable()
    signals: SignalsTable = SignalsTable()
    process: ProcessTable = ProcessTable()
    realtime: RealtimeTable = RealtimeTable()
    log: LogTable = LogTable()
