"""From the configuration to a connected backend."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

from sim_vehicle.backends.ardupilot_backend import ArdupilotJsonBackend
from sim_vehicle.backends.barrier import open_barrier
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
    backend = config.backend
    with contextlib.ExitStack() as stack:
        period_us = round(backend.barrier_period_s * 1e6)
        barrier = stack.enter_context(open_barrier(backend.barrier_port, period_us))
        if backend.kind == "px4-hil":
            px4 = backend.px4_hil
            port = stack.enter_context(Px4Port(px4.host, px4.port, config.link.allow_remote))
            yield Px4HilBackend(config, port, say, barrier=barrier)
            return
        endpoints = [parse_endpoint(url, config.link.allow_remote) for url in _urls(config)]
        links = stack.enter_context(Links(endpoints))
        if backend.kind == "ardupilot-json":
            yield ArdupilotJsonBackend(config, links, say, barrier)
        else:
            yield BundledBackend(config, links)


def _urls(config: SimConfig) -> tuple[str, ...]:
    if config.backend.kind == "ardupilot-json":
        section = config.backend.ardupilot_json
        return (f"udpin:{section.host}:{section.port}",)
    return config.link.endpoints
