"""The numbers of configs/paper.toml, checked, and the controllers that they make."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from kffa_offboard.config import bundled, read_toml
from kffa_offboard.config_errors import explain
from kffa_offboard.control import Array, fuzzy
from kffa_offboard.control.controllers import ControllerName, ControllerParameters
from kffa_offboard.control.design import DesignSettings, design
from kffa_offboard.errors import UserError
from kffa_offboard.experiments import plant

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
FourPositive = tuple[Positive, Positive, Positive, Positive]
FourNotNegative = tuple[NotNegative, NotNegative, NotNegative, NotNegative]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Channels(_Table):
    """Table 3."""

    b0: FourPositive
    omega_c_rad_s: FourPositive
    omega_o_rad_s: FourPositive


class Differentiator(_Table):
    """Constants below eq 17."""

    acceleration: Positive
    filter_time_s: Positive


class Pid(_Table):
    """Parallel gains, as accelerations per error."""

    kp: FourPositive
    ki: FourNotNegative
    kd: FourNotNegative


class HandTuned(_Table):
    """The WB-LADRC."""

    natural_frequency_rad_s: FourPositive
    damping_ratio: FourPositive


class Fuzzy(_Table):
    """Scaling of the rule base."""

    error_scale: FourPositive
    error_rate_scale: FourPositive
    omega_c_range_rad_s: FourPositive


class Kalman(_Table):
    """Noise model of the Kalman filter."""

    measurement_variance: FourPositive
    disturbance_intensity: FourPositive


class Examples(_Table):
    """What is flown in Examples 1-4."""

    step: FourPositive
    step_duration_s: Positive
    triangle_period_s: Positive
    triangle_cycles: Annotated[int, Field(ge=1)]
    load_kg: Annotated[float, Field(gt=0.0, le=plant.LOAD_LIMIT)]
    load_limit_kg: Annotated[float, Field(gt=0.0, le=plant.LOAD_LIMIT)]
    load_on_s: Positive
    load_off_s: Positive
    duration_s: Positive
    noise_std: Positive
    wind_amplitude_m_s2: NotNegative
    settled_after_s: Positive
    seeds: Annotated[int, Field(ge=1, le=1000)]


class PositionRing(_Table):
    """What is flown with the position ring, and in which wind."""

    seeds: Annotated[int, Field(ge=1, le=1000)]
    yaw_rad: Annotated[float, Field(ge=-3.2, le=3.2)]
    drag_n_s_m: NotNegative
    wind_m_s: tuple[Finite, Finite, Finite]
    gust_std_m_s: NotNegative
    gust_time_constant_s: Positive
    delay_s: Annotated[float, Field(ge=0.0, le=0.2)]
    position_noise_m: tuple[NotNegative, NotNegative, NotNegative]
    velocity_noise_m_s: NotNegative
    attitude_noise_rad: NotNegative
    body_rate_noise_rad_s: NotNegative
    altitude_m: Positive
    load_kg: Annotated[float, Field(gt=0.0, le=plant.LOAD_LIMIT)]
    lead_s: Positive
    hover_s: Positive
    step_m: Positive
    step_s: Positive
    side_s: Positive

    @property
    def pick_up_s(self) -> float:
        """When the hovering vehicle takes its load."""
        return self.lead_s + self.hover_s

    @property
    def drop_s(self) -> float:
        """When the hovering vehicle drops it."""
        return self.lead_s + 2.0 * self.hover_s

    @property
    def square_drop_s(self) -> float:
        """When the load is dropped on the square: in the middle of its second side."""
        return self.lead_s + 1.5 * self.side_s


class PaperSettings(_Table):
    """The whole of configs/paper.toml."""

    channels: Channels
    differentiator: Differentiator
    pid: Pid
    pid_no_integral: Pid
    wb_ladrc: HandTuned
    fuzzy: Fuzzy
    kalman: Kalman
    examples: Examples
    position: PositionRing


def load(path: Path | None = None) -> PaperSettings:
    """Read the settings; the bundled file by default. Raises UserError, one line for each mistake."""
    path = bundled("paper.toml") if path is None else path
    try:
        return PaperSettings.model_validate(read_toml(path))
    except ValidationError as error:
        raise UserError("\n".join(f"{path}: {line}" for line in explain(error, PaperSettings))) from error


@dataclass(frozen=True)
class Variant:
    """One controller as it is flown: the named one, and in which reading."""

    name: ControllerName
    differentiator: bool = False
    rules: fuzzy.RuleBase = "published"
    literal_filter: bool = False
    no_integral: bool = False

    @property
    def label(self) -> str:
        """Unique name, as in results.json: ``kffa-ladrc/even`` and the like."""
        readings = (
            ("no-integral", self.no_integral),
            ("even", self.rules == "even"),
            ("literal", self.literal_filter),
            ("td", self.differentiator),
        )
        return "/".join([self.name, *(word for word, chosen in readings if chosen)])


#: The paper's five, in its order.
MAIN = tuple(Variant(name) for name in ("pid", "wb-ladrc", "ladrc", "fa-ladrc", "kffa-ladrc"))
WITH_DIFFERENTIATOR = tuple(Variant(variant.name, differentiator=True) for variant in MAIN)
OTHER_READINGS = (
    Variant("pid", no_integral=True),
    Variant("fa-ladrc", rules="even"),
    Variant("kffa-ladrc", rules="even"),
    Variant("kffa-ladrc", literal_filter=True),
)


def controller(settings: PaperSettings, variant: Variant) -> ControllerParameters:
    """The controller `variant` in the paper profile: ideal actuators, no limits, eq 25 as printed."""
    channels, unlimited = settings.channels, np.full(4, np.inf)
    gains = settings.pid_no_integral if variant.no_integral else settings.pid
    return design(
        variant.name,
        DesignSettings(
            b0=np.array(channels.b0),
            omega_c=np.array(channels.omega_c_rad_s),
            omega_o=np.array(channels.omega_o_rad_s),
            lower=-unlimited,
            upper=unlimited,
            trim=plant.HOVER,
            acceleration=np.full(4, settings.differentiator.acceleration),
            filter_time=settings.differentiator.filter_time_s,
            acceleration_feedforward=0.0,
            use_differentiator=variant.differentiator,
            error_scale=np.array(settings.fuzzy.error_scale),
            error_rate_scale=np.array(settings.fuzzy.error_rate_scale),
            omega_c_range=np.array(settings.fuzzy.omega_c_range_rad_s),
            rules=variant.rules,
            measurement_variance=np.array(settings.kalman.measurement_variance),
            disturbance_intensity=np.array(settings.kalman.disturbance_intensity),
            literal_filter=variant.literal_filter,
            pid_gains=np.array([gains.kp, gains.ki, gains.kd]),
            hand_gains=_hand_gains(settings),
        ),
    )


def _hand_gains(settings: PaperSettings) -> Array:
    """Gains kp, kd, l1, l2, l3 ``(5, 4)`` of the WB-LADRC."""
    frequency = np.array(settings.wb_ladrc.natural_frequency_rad_s)
    damping = np.array(settings.wb_ladrc.damping_ratio)
    slow, middle, fast = np.outer([1 / 3, 2 / 3, 1.0], settings.channels.omega_o_rad_s)
    return np.array(
        [
            frequency**2,
            2.0 * damping * frequency,
            slow + middle + fast,
            slow * middle + slow * fast + middle * fast,
            slow * middle * fast,
        ]
    )
