"""The configuration in a flight log, and out of it again."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from kffa_offboard import __version__
from kffa_offboard.config import DaemonConfig, Overrides, build
from kffa_offboard.config_tuning_file import RememberedTuning
from kffa_offboard.control.controllers import CHANNELS
from kffa_offboard.flightlog.notes import Header
from kffa_offboard.flightlog.signals import LIVE_ARRAY_ID, to_message
from kffa_offboard.mavlink.companion import Companion
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.parameter_check import CheckSettings
from kffa_offboard.mavlink.parameter_file import ParameterFile, RememberedChanges
from kffa_offboard.mavlink.parameter_keeper import KeeperSettings, ParameterKeeper

LIBRARIES = ("numpy", "filterpy", "pymavlink")
"""Whose versions go into the header: they take part in the arithmetic, or in the frames."""


SWITCHES = ("arm", "engage", "shadow", "fix_parameters", "trust_parameters", "interrupted")
"""Overrides that are not in the document."""


def flight_header(config: DaemonConfig, lockstep: bool, changed: ParameterFile | None = None) -> Header:
    """What the log of a flight with `config` begins with.

    `changed` is the parameter keeper's file; None for a flight without a keeper. Raises UserError if the
    file cannot be read.
    """
    said = config.overrides
    return Header(
        version=__version__,
        configuration=config.document,
        options={name: getattr(said, name) for name in SWITCHES},
        lockstep=lockstep,
        libraries={name: version(name) for name in LIBRARIES},
        parameters_checked=changed is not None and config.autopilot.check_parameters,
        changed_parameters=None if changed is None else changed.text(),
        stored_parameters=None if config.tuning.store is None else config.tuning.store.read(),
    )


def config_of(header: Header, log: Path) -> DaemonConfig:
    """The configuration that a flight was flown with; errors are named after `log`.

    Raises ConfigError if this version cannot fly it (a key that it does not know, for instance).
    """
    store = RememberedTuning(log, header.stored_parameters)
    return build(header.configuration, log, overrides_of(header), store)


def overrides_of(header: Header) -> Overrides:
    """What the command line of a flight said beyond its file."""
    return Overrides(**header.options)  # type: ignore[arg-type]


def parameter_keeper(config: DaemonConfig, route: Route, file: ParameterFile) -> ParameterKeeper:
    """What reads, judges, sets and puts back the vehicle's parameters."""
    service = config.service
    settings = KeeperSettings(CheckSettings.of(service), config.autopilot.fix_parameters, service.shadow)
    return ParameterKeeper(route, settings, file)


def recorded_keeper(header: Header, config: DaemonConfig, route: Route, log: Path) -> ParameterKeeper | None:
    """The parameter keeper of a recorded flight, None if it had none."""
    if not header.parameters_checked:
        return None
    return parameter_keeper(config, route, RememberedChanges(log, header.changed_parameters))


def make_companion(config: DaemonConfig, route: Route) -> Companion:
    """What answers ground stations: the configuration's parameters and signals."""
    return Companion(
        route,
        tuning=config.tuning,
        allowed=config.allowed,
        signals_hz=config.signals_hz,
        to_array=lambda signals: to_message(signals, LIVE_ARRAY_ID),
        vector=None if config.signals_vector is None else CHANNELS.index(config.signals_vector),
    )
