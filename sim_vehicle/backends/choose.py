"""From the configuration to a connected backend."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from sim_vehicle.backends.ardupilot_backend import ArdupilotJsonBackend
from sim_vehicle.backends.base import Backend, Say
from sim_vehicle.backends.bundled import BundledBackend
from sim_vehicle.backends.px4_backend import Px4HilBackend
from sim_vehicle.backends.px4_port import Px4Port
from sim_vehicle.config import SimConfig
from sim_vehicle.endpoints import parse_endpoint
from sim_vehicle.links import Links


@contextlib.contextmanager
def open_backend(config: SimConfig, say: Say) -> Iterator[Backend]:
    """Yield the backend of `config.backend.kind`, with its sockets open; close them afterwards.

    Raises SimulatorError if an address cannot be had.
    """
    if config.backend.kind == "px4-hil":
        with Px4Port(
            config.backend.px4_hil.host, config.backend.px4_hil.port, config.link.allow_remote
        ) as port:
            yield Px4HilBackend(config, port, say)
        return
    with Links([parse_endpoint(url, config.link.allow_remote) for url in _urls(config)]) as links:
        if config.backend.kind == "ardupilot-json":
            yield ArdupilotJsonBackend(config, links, say)
        else:
            yield BundledBackend(config, links)


def _urls(config: SimConfig) -> tuple[str, ...]:
    if config.backend.kind == "ardupilot-json":
        section = config.backend.ardupilot_json
        return (f"udpin:{section.host}:{section.port}",)
    return config.link.endpoints
