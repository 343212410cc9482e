"""The configuration in a flight log, and out of it again."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path

from kffa_offboard import __version__
from kffa_offboard.config import DaemonConfig, Overrides, build
from kffa_offboard.flightlog.notes import Header

LIBRARIES = ("numpy", "filterpy", "pymavlink")
"""Whose versions go into the header: they take part in the arithmetic, or in the frames."""


def flight_header(config: DaemonConfig, lockstep: bool) -> Header:
    """What the log of a flight with `config` begins with."""
    said = config.overrides
    return Header(
        version=__version__,
        configuration=config.document,
        options={"arm": said.arm, "engage": said.engage, "shadow": said.shadow},
        lockstep=lockstep,
        libraries={name: version(name) for name in LIBRARIES},
    )


def config_of(header: Header, log: Path) -> DaemonConfig:
    """The configuration that a flight was flown with; errors are named after `log`.

    Raises ConfigError if this version cannot fly it (a key that it does not know, for instance).
    """
    return build(header.configuration, log, overrides_of(header))


def overrides_of(header: Header) -> Overrides:
    """What the command line of a flight said beyond its file."""
    return Overrides(**header.options)  # type: ignore[arg-type]
