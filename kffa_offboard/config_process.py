"""The tables `[process]` and `[realtime]`: what the daemon does as a process of the operating system."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from kffa_offboard.config_control import Table
from kffa_offboard.config_units import number
from kffa_offboard.process.realtime import RealtimeSettings

_REALTIME = RealtimeSettings()


@dataclass(frozen=True)
class ProcessSettings:
    """What the daemon does as a process.

    Attributes
    ----------
    reengage : with --engage, take control again after a restart in flight
    late_step_s : from when on a control step is late
    dead_man_switch : a process of its own sends a level setpoint if this one dies or hangs in control
    """

    reengage: bool = False
    dead_man_switch: bool = True
    late_step_s: float = 0.005


_PROCESS = ProcessSettings()


class ProcessTable(Table):
    """`[process]`: `ProcessSettings`."""

    reengage: bool = _PROCESS.reengage
    dead_man_switch: bool = _PROCESS.dead_man_switch
    late_step_s: Annotated[float, number("s", at_least=1e-4, at_most=1.0)] = _PROCESS.late_step_s

    def settings(self) -> ProcessSettings:
        """The same as a record."""
        return ProcessSettings(**self.model_dump())


class RealtimeTable(Table):
    """`[realtime]`: `process.realtime.RealtimeSettings`."""

    enabled: bool = _REALTIME.enabled
    required: bool = _REALTIME.required
    priority: Annotated[int, Field(ge=0, le=99)] = _REALTIME.priority
    pin: bool = _REALTIME.pin
    core: Annotated[int | None, Field(ge=0, le=1023)] = None
    lock_memory: bool = _REALTIME.lock_memory
    keep_awake: bool = _REALTIME.keep_awake
    collect_s: Annotated[float, number("s", at_least=0.1, at_most=60.0)] = _REALTIME.collect_s

    def settings(self) -> RealtimeSettings:
        """The same as a record."""
        return RealtimeSettings(**self.model_dump())
