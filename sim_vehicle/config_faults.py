"""[faults] of the configuration: what breaks on the vehicle, and when."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from sim_vehicle.config_base import NotNegative, Number, Section

Share = Annotated[float, Field(ge=0.0, le=1.0)]


class ThrustLimit(Section):
    """From `start_s` for `duration_s` no motor gives more than `share` of its full thrust."""

    start_s: NotNegative
    duration_s: NotNegative
    share: Share


class WeakMotor(Section):
    """From `start_s` on motor `motor` (1 front, 2 left, 3 rear, 4 right) gives `loss` less than it should."""

    start_s: NotNegative
    motor: Annotated[int, Field(ge=1, le=4)] = 1
    loss: Share = 0.3


class BatterySag(Section):
    """From `start_s` on full thrust falls by `loss_per_s` of itself each second, to `lowest` at most."""

    start_s: NotNegative
    loss_per_s: NotNegative
    lowest: Share = 0.5


class Gust(Section):
    """From `start_s` for `duration_s` wind of `velocity_m_s` is added; it comes and goes at once."""

    start_s: NotNegative
    duration_s: NotNegative
    velocity_m_s: tuple[Number, Number, Number] = (12.0, 0.0, 0.0)


class SatelliteLoss(Section):
    """From `start_s` for `duration_s` (None: for good) the estimator has no satellites.

    Its speed over ground drifts by `drift_m_s2` (x, y) from the true one, and its place with it.
    """

    start_s: NotNegative
    duration_s: NotNegative | None = None
    drift_m_s2: tuple[Number, Number] = (0.05, 0.0)


class FaultsSection(Section):
    """[faults]: each a list; times in seconds since power-up."""

    thrust_limit: tuple[ThrustLimit, ...] = ()
    weak_motor: tuple[WeakMotor, ...] = ()
    battery_sag: tuple[BatterySag, ...] = ()
    gust: tuple[Gust, ...] = ()
    satellite_loss: tuple[SatelliteLoss, ...] = ()
