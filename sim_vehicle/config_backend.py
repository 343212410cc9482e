"""[backend]: which autopilot flies the plant, and how it is connected."""

from __future__ import annotations

from typing import Annotated, Literal, Self, TypeAlias

from pydantic import Field, field_validator, model_validator

from sim_vehicle.config_base import Noise, NotNegative, Section

BackendKind: TypeAlias = Literal["bundled", "ardupilot-json", "px4-hil"]
Channel: TypeAlias = Annotated[int, Field(ge=1, le=32)]
Output: TypeAlias = Annotated[int, Field(ge=1, le=16)]
PulseWidth: TypeAlias = Annotated[int, Field(ge=500, le=2500)]

SLOWEST = 0.01
"""Least real-time factor above 0, which has a meaning of its own."""

SMALLEST_TRAVEL_US = 100
"""Servo end points nearer than this could not be told apart [us]."""


PHYSICS_STEP_S: dict[str, float] = {"ardupilot-json": 0.00125, "px4-hil": 0.002}
"""Default of vehicle.physics_dt_s by backend.kind, where the firmware wants another step."""


class ArdupilotJsonSection(Section):
    """[backend.ardupilot_json]: the port that ArduPilot's JSON simulator interface calls, and its outputs."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 9002
    pace: Literal["physics", "firmware"] = "physics"
    """Who keeps to the clock: the physics (`backend.real_time_factor`) or the firmware (its `--speedup`)."""
    motor_channels: tuple[Channel, Channel, Channel, Channel] = (3, 2, 4, 1)
    """Servo outputs of the front, left, rear and right motor; the default is ArduCopter's plus quadrotor."""
    motor_pwm_min_us: PulseWidth = 1000
    motor_pwm_max_us: PulseWidth = 2000
    gripper_channel: Annotated[int, Field(ge=0, le=32)] = 9
    """Servo output of the gripper; 0 for none."""
    gripper_grab_us: PulseWidth = 1900
    gripper_release_us: PulseWidth = 1100

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.motor_channels)) < len(self.motor_channels):
            raise ValueError(
                f"motor_channels = {list(self.motor_channels)}: a channel is given twice; "
                "name four outputs: front, left, rear, right"
            )
        if self.gripper_channel in self.motor_channels:
            raise ValueError(
                f"gripper_channel = {self.gripper_channel}: that output drives a motor; "
                "choose another, or 0 for no gripper"
            )
        if self.motor_pwm_max_us - self.motor_pwm_min_us < SMALLEST_TRAVEL_US:
            raise ValueError(
                f"motor_pwm_max_us = {self.motor_pwm_max_us}: not {SMALLEST_TRAVEL_US} us above "
                f"motor_pwm_min_us = {self.motor_pwm_min_us}; give the firmware's MOT_PWM_MIN and MOT_PWM_MAX"
            )
        if abs(self.gripper_grab_us - self.gripper_release_us) < SMALLEST_TRAVEL_US:
            raise ValueError(
                f"gripper_grab_us = {self.gripper_grab_us}: within {SMALLEST_TRAVEL_US} us of "
                f"gripper_release_us = {self.gripper_release_us}; give the firmware's GRIP_GRAB and "
                "GRIP_RELEASE"
            )
        return self


class Px4HilSection(Section):
    """[backend.px4_hil]: the port that PX4's simulator_mavlink calls, and its outputs."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=0, le=65535)] = 4560
    """4560 + N for px4 -i N."""
    outputs_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)] = 1.0
    """Wall time without motor outputs after which simulated time goes on slowly with the last ones."""
    motor_outputs: tuple[Output, Output, Output, Output] = (1, 2, 3, 4)
    """Outputs (PWM_MAIN_FUNCn) of the front, left, rear and right motor."""
    gripper_output: Annotated[int, Field(ge=0, le=16)] = 5
    """Output of the gripper, the one with PWM_MAIN_FUNCn 430; 0 for none."""
    range_finder: bool = False
    """A range finder that looks down: 20 Hz, 2 cm of noise."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if len(set(self.motor_outputs)) < len(self.motor_outputs):
            raise ValueError(
                f"motor_outputs = {list(self.motor_outputs)}: an output is given twice; "
                "name four: front, left, rear, right"
            )
        if self.gripper_output in self.motor_outputs:
            raise ValueError(
                f"gripper_output = {self.gripper_output}: that output drives a motor; "
                "choose another, or 0 for no gripper"
            )
        return self


class BackendSection(Section):
    """[backend]: the bundled firmware, or real firmware over its own simulator interface."""

    kind: BackendKind = "bundled"
    real_time_factor: Annotated[float, Field(ge=0.0, le=100.0)] = 1.0
    """Simulated seconds per second; 0 for as fast as possible."""
    barrier_port: Annotated[int, Field(ge=0, le=65535)] = 0
    """UDP port on loopback that lets time go on at each `barrier_period_s` (`backends.barrier`); 0: none."""
    barrier_period_s: Annotated[float, Field(ge=0.001, le=1.0)] = 0.004
    accel_noise_m_s2: Noise = 0.05
    gyro_noise_rad_s: Noise = 0.002
    """White noise on each sample of the inertial sensors (standard deviation)."""
    stall_warning_s: Annotated[float, Field(gt=0.0, le=3600.0)] = 5.0
    """Silence of the firmware after which a line on stderr says so; again after twice that time, ..."""
    stall_timeout_s: NotNegative = 0.0
    """Silence after which the simulator gives up with status 2; 0 to wait for ever."""
    ardupilot_json: ArdupilotJsonSection = ArdupilotJsonSection()
    px4_hil: Px4HilSection = Px4HilSection()

    @field_validator("real_time_factor")
    @classmethod
    def _not_asleep(cls, value: float) -> float:
        if 0.0 < value < SLOWEST:
            raise ValueError(f"too small; give {SLOWEST:g} or more, or 0 for as fast as possible")
        return value
