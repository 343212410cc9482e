"""The `[control]` table: the numbers of each channel, and how they make a controller.

Every default fits the simulated 10 kg quadrotor. Angles here are radians, as in the control law.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from kffa_offboard.config_units import number
from kffa_offboard.control import Array
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.control.design import DesignSettings, three_poles
from kffa_offboard.control.fuzzy import RuleBase
from kffa_offboard.offboard.settings import LimitSettings, OutputKind

STANDARD_GRAVITY = 9.80665
_SHORTEST_HORIZON_S = 1e-4  # "no prediction" for one channel among others: a hundredth of a telemetry period

Bandwidth = Annotated[float, number("rad/s", above=0.0, at_most=1000.0)]
Delay = Annotated[float, number("s", at_least=0.0, at_most=0.5)]
OptionalDelay = Annotated[float | None, number("s", at_least=0.0, at_most=0.5)]
Gain = Annotated[float, number(at_least=0.0, at_most=1000.0)]


class Table(BaseModel):
    """A table of the configuration: fixed keys, no others."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


@dataclass(frozen=True)
class ChannelNumbers:
    """What one channel contributes to `control.design.DesignSettings`, in its units (rad or m)."""

    b0: float
    damping: float
    stiffness: float
    omega_c: float
    omega_o: float
    delay: float
    lag: float
    prediction: float
    acceleration: float
    error_scale: float
    error_rate_scale: float
    omega_c_range: float
    measurement_noise: float
    rate_noise: float
    disturbance_intensity: float


class ChannelTable(Table):
    """What all channels have: bandwidths and the delays that the observer must know.

    `delay_s` is the time from sampling the state until a command computed from it reaches the actuator,
    `lag_s` the time constant of that actuator where the plant model does not hold it. `prediction_s`
    is how far ahead of its estimate the law looks; left out, it is `delay_s`.
    """

    omega_c: Bandwidth
    omega_o: Bandwidth
    omega_c_range: Annotated[float, number("rad/s", at_least=0.0, at_most=1000.0)]
    delay_s: Delay
    lag_s: Delay = 0.0
    prediction_s: OptionalDelay = None
    disturbance_intensity: Annotated[float, number(above=0.0)]

    @model_validator(mode="after")
    def _bandwidths_fit(self) -> ChannelTable:
        if self.omega_c_range >= self.omega_c:
            raise ValueError(
                f"omega_c_range = {self.omega_c_range:g} rad/s lets the fuzzy rules take omega_c to zero; "
                f"keep it below omega_c = {self.omega_c:g} rad/s"
            )
        if self.omega_o <= self.omega_c:
            raise ValueError(
                f"omega_o = {self.omega_o:g} rad/s: the observer must be quicker than the controller; "
                f"set it above omega_c = {self.omega_c:g} rad/s, usually 3 to 5 times"
            )
        return self

    @property
    def prediction(self) -> float:
        """How far ahead of the estimate the law looks, s, more than 0."""
        wanted = self.delay_s if self.prediction_s is None else self.prediction_s
        return max(wanted, _SHORTEST_HORIZON_S)


class AltitudeTable(ChannelTable):
    """`[control.altitude]`: normalised vertical thrust to altitude."""

    hover_thrust: Annotated[float, number("of full thrust", at_least=0.05, at_most=0.9)] = Field(
        description="the thrust, 0 to 1, that carries the empty vehicle (MPC_THR_HOVER, MOT_THST_HOVER)"
    )
    damping_per_s: Annotated[float, number("1/s", at_least=0.0, at_most=50.0)] = 0.0
    omega_c: Bandwidth = 8.0
    omega_o: Bandwidth = 40.0
    omega_c_range: Annotated[float, number("rad/s", at_least=0.0, at_most=1000.0)] = 2.0
    delay_s: Delay = 0.04
    lag_s: Delay = 0.05
    acceleration_m_s2: Annotated[float, number("m/s^2", at_least=0.1, at_most=200.0)] = 5.0
    error_scale_m: Annotated[float, number("m", above=0.0, at_most=100.0)] = 0.1
    error_rate_scale_m_s: Annotated[float, number("m/s", above=0.0, at_most=100.0)] = 0.5
    measurement_noise_m: Annotated[float, number("m", above=0.0, at_most=10.0)] = 0.002
    climb_rate_noise_m_s: Annotated[float, number("m/s", above=0.0, at_most=10.0)] = 0.02
    disturbance_intensity: Annotated[float, number(above=0.0)] = 100.0

    def numbers(self) -> ChannelNumbers:
        """Plant: thrust over hover thrust times gravity is acceleration."""
        return ChannelNumbers(
            b0=STANDARD_GRAVITY / self.hover_thrust,
            damping=self.damping_per_s,
            stiffness=0.0,
            omega_c=self.omega_c,
            omega_o=self.omega_o,
            delay=self.delay_s,
            lag=self.lag_s,
            prediction=self.prediction,
            acceleration=self.acceleration_m_s2,
            error_scale=self.error_scale_m,
            error_rate_scale=self.error_rate_scale_m_s,
            omega_c_range=self.omega_c_range,
            measurement_noise=self.measurement_noise_m,
            rate_noise=self.climb_rate_noise_m_s,
            disturbance_intensity=self.disturbance_intensity,
        )


class AngleTable(ChannelTable):
    """What roll, pitch and yaw have in common, whatever they command."""

    omega_c: Bandwidth = 8.0
    omega_o: Bandwidth = 25.0
    omega_c_range: Annotated[float, number("rad/s", at_least=0.0, at_most=1000.0)] = 2.0
    delay_s: Delay = 0.04
    acceleration_rad_s2: Annotated[float, number("rad/s^2", at_least=0.1, at_most=500.0)] = 20.0
    error_scale_rad: Annotated[float, number("rad", above=0.0, at_most=3.2)] = 0.2
    error_rate_scale_rad_s: Annotated[float, number("rad/s", above=0.0, at_most=50.0)] = 1.0
    measurement_noise_rad: Annotated[float, number("rad", above=0.0, at_most=0.2)] = 0.002
    rate_noise_rad_s: Annotated[float, number("rad/s", above=0.0, at_most=2.0)] = 0.02
    disturbance_intensity: Annotated[float, number(above=0.0)] = 100.0

    def _numbers(self, b0: float, damping: float, stiffness: float) -> ChannelNumbers:
        return ChannelNumbers(
            b0=b0,
            damping=damping,
            stiffness=stiffness,
            omega_c=self.omega_c,
            omega_o=self.omega_o,
            delay=self.delay_s,
            lag=self.lag_s,
            prediction=self.prediction,
            acceleration=self.acceleration_rad_s2,
            error_scale=self.error_scale_rad,
            error_rate_scale=self.error_rate_scale_rad_s,
            omega_c_range=self.omega_c_range,
            measurement_noise=self.measurement_noise_rad,
            rate_noise=self.rate_noise_rad_s,
            disturbance_intensity=self.disturbance_intensity,
        )


class RateAxisTable(AngleTable):
    """`[control.rates.AXIS]`: the autopilot follows a body-rate setpoint with a first-order lag."""

    rate_time_constant_s: Annotated[float, number("s", at_least=0.005, at_most=3.0)] = 0.08

    def numbers(self) -> ChannelNumbers:
        """Plant: rate = setpoint behind a lag, so b0 and damping are 1 / time constant."""
        return self._numbers(1.0 / self.rate_time_constant_s, 1.0 / self.rate_time_constant_s, 0.0)


class AttitudeAxisTable(AngleTable):
    """`[control.attitude.AXIS]`: the autopilot follows an attitude setpoint as a second-order system."""

    natural_frequency_rad_s: Annotated[float, number("rad/s", above=0.0, at_most=100.0)] = 8.0
    damping_ratio: Annotated[float, number(at_least=0.0, at_most=3.0)] = 0.9

    def numbers(self) -> ChannelNumbers:
        """Plant: b0 and stiffness are omega_n^2, damping is 2 zeta omega_n."""
        omega_n = self.natural_frequency_rad_s
        return self._numbers(omega_n**2, 2.0 * self.damping_ratio * omega_n, omega_n**2)


_SLOW_YAW = {"omega_c": 2.5, "omega_o": 10.0, "omega_c_range": 0.5}


class RatesTable(Table):
    """`[control.rates]`, read with output = "rates"."""

    roll: RateAxisTable = RateAxisTable()
    pitch: RateAxisTable = RateAxisTable()
    yaw: RateAxisTable = RateAxisTable(rate_time_constant_s=0.3, **_SLOW_YAW)


class AttitudeTable(Table):
    """`[control.attitude]`, read with output = "attitude"."""

    roll: AttitudeAxisTable = AttitudeAxisTable()
    pitch: AttitudeAxisTable = AttitudeAxisTable()
    yaw: AttitudeAxisTable = AttitudeAxisTable(natural_frequency_rad_s=3.0, damping_ratio=1.0, **_SLOW_YAW)


class CascadeTable(Table):
    """`[control.cascade]`: gains of controller = "cascaded-pid"; PX4's names and defaults."""

    roll_p: Gain = 6.5
    pitch_p: Gain = 6.5
    yaw_p: Gain = 2.8
    altitude_p: Gain = 1.0
    climb_rate_p: Gain = 4.0
    climb_rate_i: Gain = 2.0

    def gains(self) -> Array:
        """(3, 4): outer P, inner I, inner P of roll, pitch, yaw, altitude."""
        outer = [self.roll_p, self.pitch_p, self.yaw_p, self.altitude_p]
        return np.array([outer, [0.0, 0.0, 0.0, self.climb_rate_i], [0.0, 0.0, 0.0, self.climb_rate_p]])


_ALL_GAINS = "all three gains, or leave the table out"


class PidAxisTable(Table):
    """`[control.pid.CHANNEL]`: gains of one channel, per unit of acceleration: 1/s^2, 1/s^3, 1/s."""

    p: Gain = Field(description=_ALL_GAINS)
    i: Gain = Field(description=_ALL_GAINS)
    d: Gain = Field(description=_ALL_GAINS)


class PidTable(Table):
    """`[control.pid]`: gains of controller = "pid"; a channel left out has three poles at omega_c / 2."""

    roll: PidAxisTable | None = None
    pitch: PidAxisTable | None = None
    yaw: PidAxisTable | None = None
    altitude: PidAxisTable | None = None

    def gains(self, omega_c: Array) -> Array:
        """(3, 4): kp, ki, kd of roll, pitch, yaw, altitude."""
        gains = three_poles(omega_c)
        for channel, given in enumerate((self.roll, self.pitch, self.yaw, self.altitude)):
            if given is not None:
                gains[:, channel] = given.p, given.i, given.d
        return gains


class ControlTable(Table):
    """`[control]`: which controller flies, what it commands, and its numbers."""

    controller: ControllerName = "kffa-ladrc"
    output: OutputKind = "rates"
    rules: RuleBase = "even"
    kalman: Literal["extended", "literal"] = "extended"
    fuse_rates: bool = True
    reference_filter_s: Annotated[float, number("s", at_least=0.005, at_most=2.0)] = 0.1
    altitude: AltitudeTable = Field(description="the table [control.altitude] with at least hover_thrust")
    rates: RatesTable = RatesTable()
    attitude: AttitudeTable = AttitudeTable()
    cascade: CascadeTable = CascadeTable()
    pid: PidTable = PidTable()

    def settings(self, limits: LimitSettings) -> DesignSettings:
        """The numbers in the form that `control.design.design` takes."""
        axes = self.rates if self.output == "rates" else self.attitude
        channels = [axes.roll.numbers(), axes.pitch.numbers(), axes.yaw.numbers(), self.altitude.numbers()]
        stacked: dict[str, Any] = {
            item.name: np.array([getattr(channel, item.name) for channel in channels])
            for item in fields(ChannelNumbers)
        }
        measurement_noise, rate_noise = stacked.pop("measurement_noise"), stacked.pop("rate_noise")
        bound, rate = self._command_limits(limits)
        return DesignSettings(
            **stacked,
            lower=np.array([*(-bound), 0.0]),
            upper=np.array([*bound, limits.thrust_max]),
            rate=np.array([*rate, limits.thrust_rate_max_per_s]),
            trim=np.array([0.0, 0.0, 0.0, self.altitude.hover_thrust]),
            filter_time=self.reference_filter_s,
            rules=self.rules,
            measurement_variance=measurement_noise**2,
            rate_variance=rate_noise**2 if self.fuse_rates else None,
            literal_filter=self.kalman == "literal",
            pid_gains=self.pid.gains(stacked["omega_c"]),
            cascade_gains=self.cascade.gains(),
            cascade_to_attitude=self.output == "attitude",
        )

    def _command_limits(self, limits: LimitSettings) -> tuple[Array, Array]:
        """Largest command of roll, pitch and yaw and its largest change per second; heading is free."""
        rates = np.array(limits.body_rate_max_rad_s)
        if self.output == "rates":
            return rates, np.full(3, limits.body_rate_change_max_rad_s2)
        return np.array([limits.tilt_max_rad, limits.tilt_max_rad, np.inf]), rates
