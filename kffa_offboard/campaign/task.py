"""The unit of work: one batch of flights of one controller, and the table that comes of it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kffa_offboard.campaign.flight import WIDTH, fly
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.control.controllers import ControllerName

Table = dict[str, NDArray[np.float64] | NDArray[np.int64]]
"""Columns by name, one row for each flight: its number, its conditions, its outcomes."""


@dataclass(frozen=True)
class Task:
    """Flights `first` .. `last` - 1 under one controller, flown in batches of `width`."""

    controller: ControllerName
    first: int
    last: int
    width: int = WIDTH

    @property
    def name(self) -> str:
        """What it is called on disk and on a cluster."""
        return f"{self.controller}-{self.first:08d}-{self.last - 1:08d}"

    @property
    def count(self) -> int:
        """Number of flights."""
        return self.last - self.first


def tasks(campaign: Campaign, flights: int, width: int = WIDTH) -> Iterator[Task]:
    """All tasks of a campaign; the first flights of every controller come first."""
    for first in range(0, flights, width):
        for controller in campaign.services:
            yield Task(controller, first, min(first + width, flights), width)


def run(campaign: Campaign, task: Task) -> tuple[Task, Table]:
    """Fly a task; here or in whatever process it was sent to."""
    numbers = np.arange(task.first, task.last)
    conditions, outcomes = fly(campaign, task.controller, numbers, task.width)
    return task, {"flight": numbers, **vars(conditions), **vars(outcomes)}
