"""Reading a configuration file: from TOML to the frozen records that the daemon flies with.

Every problem of a file is reported, one line each, and nothing is opened or flown before the file is right.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields, replace
from math import radians
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from kffa_offboard.config_control import ControlTable, Table
from kffa_offboard.config_errors import explain
from kffa_offboard.config_process import ProcessSettings
from kffa_offboard.config_tables import ConfigFile
from kffa_offboard.config_together import check_together
from kffa_offboard.config_tuning import ConfigTuning
from kffa_offboard.config_tuning_file import TuningFile
from kffa_offboard.control.controllers import ControllerName, ControllerParameters
from kffa_offboard.control.design import design
from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.address import parse_url
from kffa_offboard.mavlink.autopilot import GuidedMode
from kffa_offboard.mavlink.senders import Sender, parse_sender
from kffa_offboard.mavlink.signed_link import SigningSettings
from kffa_offboard.offboard.settings import (
    FlightSettings,
    LimitSettings,
    OutputKind,
    SequenceSettings,
    ServiceSettings,
    TelemetrySettings,
)
from kffa_offboard.offboard.swinging import for_swinging_load
from kffa_offboard.offboard.tuning import TuningProblem, TuningStore
from kffa_offboard.process.realtime import RealtimeSettings

Record = TypeVar("Record", TelemetrySettings, LimitSettings, SequenceSettings, FlightSettings)


class ConfigError(UserError):
    """A configuration that cannot be flown; one line of text for each problem."""

    def __init__(self, file: str, problems: list[str]) -> None:
        super().__init__("\n".join(f"{file}: {problem}" for problem in problems))


@dataclass(frozen=True)
class Overrides:
    """What the command line says about a configuration; None leaves the file's word."""

    link: str | None = None
    controller: ControllerName | None = None
    output: OutputKind | None = None
    arm: bool = False
    engage: bool = False
    shadow: bool = False
    fix_parameters: bool = False
    trust_parameters: bool = False
    interrupted: bool = False


@dataclass(frozen=True)
class AutopilotSettings:
    """What is done with the autopilot's own parameters, and which mode of ArduPilot flies."""

    check_parameters: bool = True
    fix_parameters: bool = False
    ardupilot_mode: GuidedMode = "guided"


@dataclass(frozen=True)
class LinkSettings:
    """Where the vehicle is, the MAVLink ids of both ends, and signing (None: off)."""

    url: str
    allow_remote: bool
    system_id: int
    component_id: int
    target_system: int
    target_component: int
    connect_timeout_s: float
    barrier_timeout_s: float
    signing: SigningSettings | None


@dataclass(frozen=True)
class LogSettings:
    """Where flight logs go (None for no log), and after how many bytes the next file begins (None: never)."""

    directory: Path | None
    part_size: int | None


@dataclass(frozen=True)
class DaemonConfig:
    """All that `kffa-offboard run` needs.

    Attributes
    ----------
    path : the file
    link : where the vehicle is
    service : what the service flies with
    log : where flight logs go
    document : the tables it was made from, with what `overrides` changed in them
    overrides : what the command line said
    autopilot : checking of its parameters
    tuning : what may be changed in flight; its settings are `service`
    signals_hz : rate of the inner signals on the wire; 0 for none
    signals_vector : channel whose reference, estimate and disturbance go out as DEBUG_VECT; None for none
    allowed : who may command the daemon; None for everybody
    process, realtime : what the daemon does as a process
    """

    path: Path
    link: LinkSettings
    service: ServiceSettings
    log: LogSettings
    document: dict[str, Any]
    overrides: Overrides
    autopilot: AutopilotSettings
    tuning: ConfigTuning
    signals_hz: float
    signals_vector: str | None
    allowed: tuple[Sender, ...] | None
    process: ProcessSettings
    realtime: RealtimeSettings


def bundled(name: str) -> Path:
    """The configuration `name` that comes with the package, installed or in a checkout.

    Raises UserError if there is none of that name.
    """
    package = Path(__file__).resolve().parent
    for directory in (package / "configs", package.parent / "configs"):
        if (directory / name).is_file():
            return directory / name
    raise UserError(
        f"{name}: no configuration of that name comes with kffa-offboard; give a file with --config"
    )


# A table that only the other configuration has, in the order in which they are looked for.
_OTHER_PROGRAMS = {
    "campaign": "random flights; give it to `kffa-offboard campaign`",
    "examples": "the paper's examples, which `kffa-offboard paper` reads by itself",
    "vehicle": "sim-vehicle; give it to `sim-vehicle run --config`",
}


def load(path: Path, overrides: Overrides | None = None) -> DaemonConfig:
    """Read and check the file at `path`.

    Raises
    ------
    ConfigError
        One line for each problem: file, key, value, what is wrong, remedy.
    UserError
        For a bad link in `overrides`.
    """
    file = str(path)
    overrides = overrides or Overrides()
    document = read_toml(path)
    for table, use in _OTHER_PROGRAMS.items():
        if table in document and "control" not in document:
            raise ConfigError(file, [f"is a configuration of {use}"])
    if overrides.link is not None:
        parse_url(overrides.link)  # its complaint names the link, not the file
    for table, key, value in (
        ("link", "url", overrides.link),
        ("control", "controller", overrides.controller),
        ("control", "output", overrides.output),
    ):
        if value is not None and isinstance(document.setdefault(table, {}), dict):
            document[table][key] = value
    return build(document, path, overrides)


def build(
    document: dict[str, Any], path: Path, overrides: Overrides, stored: TuningStore | None = None
) -> DaemonConfig:
    """Check the tables of a file; errors are named after `path`. Raises ConfigError as `load`.

    `stored` takes the place of the file that `[parameters]` names.
    """
    file = str(path)
    tuning = ConfigTuning(document, lambda tables: _service(tables, overrides))
    try:
        tables = tuning.tables
        assert tuning.settings is not None  # made and checked here
    except ValidationError as error:
        raise ConfigError(file, explain(error, ConfigFile)) from error
    except ValueError as error:
        raise ConfigError(file, [str(error)]) from error
    if tables.parameters.file is not None:
        own = TuningFile(path.parent / Path(tables.parameters.file).expanduser())
        tuning = _with_stored(tuning, stored or own)
    return DaemonConfig(
        path=path,
        link=_link(tables, path.parent),
        service=tuning.settings,
        log=_log(tables),
        document=document,
        overrides=overrides,
        autopilot=_autopilot(tables, overrides),
        tuning=tuning,
        signals_hz=tables.signals.rate_hz,
        signals_vector=tables.signals.vector,
        allowed=_allowed(tables),
        process=tables.process.settings(),
        realtime=tables.realtime.settings(),
    )


def _with_stored(tuning: ConfigTuning, store: TuningStore) -> ConfigTuning:
    """With the values that are in `store`, if there are any; a ConfigError names it."""
    try:
        return replace(tuning, store=store).reread()
    except TuningProblem as error:
        raise ConfigError(str(store.path), [str(error)]) from error


def read_toml(path: Path) -> dict[str, Any]:
    """Parse a TOML file; ConfigError says what is wrong with it, and on which line."""
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise ConfigError(str(path), ["no such file; check the path"]) from error
    except IsADirectoryError as error:
        raise ConfigError(str(path), ["is a directory; name a TOML file in it"]) from error
    except UnicodeDecodeError as error:
        raise ConfigError(str(path), [f"is not UTF-8 text (byte {error.start}); save it as UTF-8"]) from error
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(str(path), [f"is not valid TOML: {error}"]) from error
    except OSError as error:
        raise ConfigError(str(path), [f"cannot be read: {error.strerror}"]) from error
    except (ValueError, RecursionError) as error:  # a number of thousands of digits, thousands of brackets
        raise ConfigError(str(path), ["holds a number or a nesting that is too long; shorten it"]) from error


def controller_parameters(control: ControlTable, limits: LimitSettings) -> ControllerParameters:
    """The controller that a `[control]` table describes. Raises ValueError if it is none."""
    return design(control.controller, control.settings(limits))


def _service(tables: ConfigFile, overrides: Overrides) -> ServiceSettings:
    limits = _record(LimitSettings, tables.limits)
    settings = ServiceSettings(
        controller=controller_parameters(tables.control, limits),
        hover_thrust=tables.control.altitude.hover_thrust,
        output=tables.control.output,
        scenario=tuple(segment.segment() for segment in tables.scenario.segment),
        engage=overrides.engage,
        arm=overrides.arm,
        shadow=overrides.shadow,
        interrupted=overrides.interrupted,
        failsafe_action=tables.failsafe.action,
        telemetry=_record(TelemetrySettings, tables.telemetry),
        limits=limits,
        sequence=_record(SequenceSettings, tables.sequence),
        flight=_record(FlightSettings, tables.flight),
        position=tables.position.settings(tables.control, tables.payload.rope_length_m),
        payload=tables.payload.settings(tables.control),
    )
    check_together(tables)
    return for_swinging_load(settings) if tables.payload.rope_length_m > 0.0 else settings


def _record(record: type[Record], table: Table) -> Record:
    """Fill a settings record from the table with the same keys; `_deg` keys become `_rad` fields."""
    return record(**{item.name: _value(table, item.name) for item in fields(record)})


def _value(table: Table, name: str) -> Any:
    if name == "body_rate_max_rad_s":
        return tuple(radians(getattr(table, f"{axis}_rate_max_deg_s")) for axis in ("roll", "pitch", "yaw"))
    if name in type(table).model_fields:
        return getattr(table, name)
    return radians(getattr(table, name.replace("_rad", "_deg")))


def _allowed(tables: ConfigFile) -> tuple[Sender, ...] | None:
    if tables.companion.allow is None:
        return None
    senders = (parse_sender(text) for text in tables.companion.allow)
    return tuple(sender for sender in senders if sender is not None)


def _signing(tables: ConfigFile, directory: Path) -> SigningSettings | None:
    table = tables.signing
    if table.key_file is None:
        return None
    stamps = None if table.timestamp_file is None else directory / Path(table.timestamp_file).expanduser()
    return SigningSettings(directory / Path(table.key_file).expanduser(), table.link_id, stamps)


def _link(tables: ConfigFile, directory: Path) -> LinkSettings:
    link = tables.link
    return LinkSettings(
        link.url,
        link.allow_remote,
        link.system_id,
        link.component_id,
        link.target_system,
        link.target_component,
        tables.telemetry.connect_timeout_s,
        tables.telemetry.barrier_timeout_s,
        _signing(tables, directory),
    )


def _log(tables: ConfigFile) -> LogSettings:
    directory, size = tables.log.directory, tables.log.file_size_max_mb
    return LogSettings(
        None if directory is None else Path(directory).expanduser(),
        None if size is None else round(size * 1e6),
    )


def _autopilot(tables: ConfigFile, overrides: Overrides) -> AutopilotSettings:
    table = tables.autopilot
    return AutopilotSettings(
        check_parameters=(table.check_parameters or overrides.fix_parameters)
        and not overrides.trust_parameters,
        fix_parameters=(table.fix_parameters or overrides.fix_parameters) and not overrides.trust_parameters,
        ardupilot_mode=table.ardupilot_mode,
    )
