"""The file of a campaign (configs/campaign.toml), checked, and what is flown by it."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError, model_validator

from kffa_offboard.config import ConfigError, Overrides, bundled, load, read_toml
from kffa_offboard.config_control import Table
from kffa_offboard.config_errors import explain
from kffa_offboard.config_units import number
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.experiments import plant
from kffa_offboard.experiments.airframe import STEP_S
from kffa_offboard.offboard.settings import ServiceSettings

CONTROL_HZ = (50.0, 100.0, 200.0)
"""Telemetry rates that can be flown: whole numbers of the vehicle's steps of 5 ms."""


def _ascending(ends: tuple[float, float]) -> tuple[float, float]:
    if ends[0] > ends[1]:
        raise ValueError("must begin with the lower end")
    return ends


_Mass = Annotated[float, number("kg", at_least=0.0, at_most=plant.LOAD_LIMIT)]
_Offset = Annotated[float, number("m", at_least=0.0, at_most=0.3)]
_Time = Annotated[float, number("s", at_least=0.1, at_most=60.0)]
_Speed = Annotated[float, number("m/s", at_least=0.0, at_most=30.0)]
_Factor = Annotated[float, number(at_least=0.0, at_most=100.0)]
_Delay = Annotated[float, number("s", at_least=0.0, at_most=0.2)]
_Share = Annotated[float, number(at_least=-0.5, at_most=0.5)]
_Lag = Annotated[float, number("s", at_least=0.005, at_most=0.5)]
_Range = AfterValidator(_ascending)


class CampaignTable(Table):
    """`[campaign]`: how many flights, and of what."""

    flights: Annotated[int, Field(ge=1, le=10_000_000)] = 10_000
    seed: Annotated[int, Field(ge=0)] = 1
    config: str = Field(
        default="demo-px4.toml", description='the daemon\'s configuration that flies: "demo-px4.toml", ...'
    )


class FlightTable(Table):
    """`[flight]`: what every flight has."""

    altitude_m: Annotated[float, number("m", at_least=0.5, at_most=1000.0)] = 5.0
    settle_s: Annotated[float, number("s", at_least=0.1, at_most=60.0)] = 3.0


class RandomTable(Table):
    """`[random]`: ranges [lower, upper] from which every flight draws evenly."""

    load_kg: Annotated[tuple[_Mass, _Mass], _Range] = (0.0, plant.LOAD_LIMIT)
    load_offset_m: Annotated[tuple[_Offset, _Offset], _Range] = (0.0, 0.05)
    drop_after_s: Annotated[tuple[_Time, _Time], _Range] = (3.0, 8.0)
    wind_m_s: Annotated[tuple[_Speed, _Speed], _Range] = (0.0, 8.0)
    gust_std_m_s: Annotated[tuple[_Speed, _Speed], _Range] = (0.0, 2.0)
    noise_factor: Annotated[tuple[_Factor, _Factor], _Range] = (0.5, 2.0)
    link_delay_s: Annotated[tuple[_Delay, _Delay], _Range] = (0.01, 0.03)
    hover_thrust_error: Annotated[tuple[_Share, _Share], _Range] = (-0.15, 0.15)
    motor_lag_s: Annotated[tuple[_Lag, _Lag], _Range] = (0.03, 0.08)


class VehicleTable(Table):
    """`[vehicle]`: what of the simulated quadrotor may be chosen."""

    load_below_m: Annotated[float, number("m", at_least=0.0, at_most=1.0)] = 0.3
    drag_n_s_m: Annotated[float, number(at_least=0.0, at_most=10.0)] = 0.6
    gust_time_constant_s: Annotated[float, number("s", at_least=0.05, at_most=60.0)] = 2.0


class NoiseTable(Table):
    """`[noise]`: standard deviations of what the autopilot reports."""

    attitude_rad: Annotated[float, number("rad", at_least=0.0, at_most=0.2)] = 0.002
    body_rate_rad_s: Annotated[float, number("rad/s", at_least=0.0, at_most=2.0)] = 0.01
    altitude_m: Annotated[float, number("m", at_least=0.0, at_most=2.0)] = 0.01
    climb_rate_m_s: Annotated[float, number("m/s", at_least=0.0, at_most=5.0)] = 0.02


class FailedTable(Table):
    """`[failed]`: what makes a flight a failed one."""

    altitude_error_max_m: Annotated[float, number("m", above=0.0, at_most=100.0)] = 2.0
    tilt_max_deg: Annotated[float, number("deg", at_least=3.0, at_most=80.0)] = 45.0
    recovered_m: Annotated[float, number("m", above=0.0, at_most=10.0)] = 0.1
    recovery_max_s: Annotated[float, number("s", at_least=0.1, at_most=60.0)] = 5.0


class CampaignFile(Table):
    """The whole file; every table may be left out."""

    campaign: CampaignTable = CampaignTable()
    flight: FlightTable = FlightTable()
    random: RandomTable = RandomTable()
    vehicle: VehicleTable = VehicleTable()
    noise: NoiseTable = NoiseTable()
    failed: FailedTable = FailedTable()

    @model_validator(mode="before")
    @classmethod
    def _lists_are_ranges(cls, document: Any) -> Any:
        """TOML has lists where the tables have pairs."""
        ranges = document.get("random")
        if not isinstance(ranges, dict):
            return document
        pairs = {key: tuple(value) if isinstance(value, list) else value for key, value in ranges.items()}
        return {**document, "random": pairs}


@dataclass(frozen=True)
class Campaign:
    """What is flown: the file's numbers, and the daemon's settings for each controller.

    Picklable; workers of a cluster get it as it is.
    """

    file: CampaignFile
    services: dict[ControllerName, ServiceSettings]
    control_s: float

    @property
    def duration_s(self) -> float:
        """Of the longest flight."""
        return self.file.flight.settle_s + self.file.random.drop_after_s[1] + self.file.failed.recovery_max_s

    @property
    def steps(self) -> int:
        """Control steps of every flight; whoever has dropped early goes on hovering."""
        return round(self.duration_s / self.control_s)

    def digest(self, controller: ControllerName) -> str:
        """Short name of all that decides about the flights of a controller, but not of their number."""
        tables = self.file.model_dump(mode="json")
        del tables["campaign"]["flights"]
        text = json.dumps([tables, repr(self.services[controller])], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def load_campaign(path: Path, controllers: tuple[ControllerName, ...] = ()) -> Campaign:
    """Read the file at `path`, and the daemon's configuration that it names.

    `controllers` fly instead of the configuration's own. Raises ConfigError, one line for each problem.
    """
    document = read_toml(path)
    if not document:
        raise ConfigError(str(path), ["holds no key; leave it out for the bundled campaign"])
    if "control" in document and "campaign" not in document:
        use = "the daemon; name it in a campaign's file as campaign.config, or give it to `kffa-offboard run`"
        raise ConfigError(str(path), [f"is a configuration of {use}"])
    try:
        file = CampaignFile.model_validate(document)
    except ValidationError as error:
        raise ConfigError(str(path), explain(error, CampaignFile)) from error
    beside = path.parent / Path(file.campaign.config).expanduser()
    config = beside if beside.is_file() else bundled(file.campaign.config)
    chosen = controllers or (load(config).service.controller.name,)
    services = {name: load(config, Overrides(controller=name, output="rates")).service for name in chosen}
    rate_hz = next(iter(services.values())).telemetry.attitude_hz
    if rate_hz not in CONTROL_HZ:
        raise ConfigError(
            str(config),
            [f"telemetry.attitude_hz = {rate_hz:g}: a campaign flies 50, 100 or 200 Hz; choose one of them"],
        )
    return Campaign(file, services, round(1.0 / (rate_hz * STEP_S)) * STEP_S)
