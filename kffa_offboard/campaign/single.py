"""One flight of a campaign alone, with everything that happens in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kffa_offboard import __version__
from kffa_offboard.campaign.conditions import Conditions
from kffa_offboard.campaign.flight import WIDTH, Moment, fly
from kffa_offboard.campaign.measure import FAILURES, Outcomes
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.control import Array
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.report.flight import CHANNELS, Channel, Flight, FlightEvent, Line, Origin, Quantity


@dataclass(frozen=True)
class SingleFlight:
    """A flight and its traces, T control steps.

    Attributes
    ----------
    conditions, outcomes : columns of one row, as in the campaign
    time_s : (T,)
    rigid : (T, 12) true state, see `experiments.airframe`
    load_kg : (T,)
    blocks : (T, 4) each, of the controller
    """

    number: int
    controller: ControllerName
    conditions: Conditions
    outcomes: Outcomes
    time_s: Array
    rigid: Array
    load_kg: Array
    blocks: dict[Quantity, Array]

    @property
    def failure(self) -> str:
        """Why it failed; empty if it did not."""
        return FAILURES[int(self.outcomes.failure[0])]

    @property
    def pickup_s(self) -> float:
        """When the load was picked up."""
        return float(self.time_s[np.argmax(self.load_kg > 0.0)])

    @property
    def drop_s(self) -> float:
        """When it was dropped."""
        return float(self.time_s[len(self.load_kg) - 1 - np.argmax(self.load_kg[::-1] > 0.0)])

    def row(self) -> dict[str, float]:
        """Conditions and outcomes as plain numbers."""
        columns = {**vars(self.conditions), **vars(self.outcomes)}
        return {name: float(values[0]) for name, values in columns.items()}


def fly_alone(
    campaign: Campaign, controller: ControllerName, number: int, width: int = WIDTH
) -> SingleFlight:
    """Fly the flight `number`: the same to the last bit as in the campaign."""
    seen: list[tuple[Array, ...]] = []

    def watch(moment: Moment) -> None:
        output = moment.output
        blocks = (moment.reference, moment.measured, output.estimate, output.command, output.disturbance,
                  output.omega_c)  # fmt: skip
        now = [np.array([moment.time]), moment.rigid[:, 0].copy(), moment.load_kg[:1].copy()]
        seen.append((*now, *(block[:, 0].copy() for block in blocks)))

    conditions, outcomes = fly(campaign, controller, np.array([number]), width, watch)
    stacked = [np.array(rows) for rows in zip(*seen, strict=True)]
    lost_at = outcomes.failed_at_s[0] if outcomes.failure[0] < len(FAILURES) - 1 else np.nan
    ends = conditions.drop_after_s[0] + campaign.file.flight.settle_s + campaign.file.failed.recovery_max_s
    shown = stacked[0][:, 0] <= np.fmin(lost_at, ends)
    time, rigid, load, reference, measured, estimate, command, disturbance, omega_c = (
        rows[shown] for rows in stacked
    )
    blocks: dict[Quantity, Array] = {
        "reference": reference, "measured": measured, "estimate": estimate, "command": command,
        "disturbance": disturbance, "omega_c": omega_c,
    }  # fmt: skip
    return SingleFlight(number, controller, conditions, outcomes, time[:, 0], rigid, load[:, 0], blocks)


def as_report_flight(campaign: Campaign, flown: SingleFlight) -> Flight:
    """For the page of `kffa-offboard report`; measured is what the controller was told, late and noisy."""
    lines: dict[tuple[Quantity, Channel], Line] = {
        (quantity, channel): Line(flown.time_s, block[:, column])
        for quantity, block in flown.blocks.items()
        for column, channel in enumerate(CHANNELS)
    }
    load = float(flown.conditions.load_kg[0])
    events = []
    if flown.load_kg.any():
        events.append(FlightEvent(flown.pickup_s, "load", f"picked up {load:.2f} kg", load))
    if flown.load_kg[-1] == 0.0 and flown.load_kg.any():
        events.append(FlightEvent(flown.drop_s, "load", f"dropped {load:.2f} kg", -load))
    failed: tuple[str, ...] = ()
    if flown.failure:
        failed = (f"failed after {flown.outcomes.failed_at_s[0]:.2f} s: {flown.failure}",)
    return Flight(
        name=f"flight {flown.number}, {flown.controller}",
        origin=Origin(
            f"flight {flown.number} of seed {campaign.file.campaign.seed}",
            version=__version__,
            libraries={"numpy": np.__version__},
            configuration={
                "conditions": {name: float(values[0]) for name, values in vars(flown.conditions).items()},
                **campaign.file.model_dump(mode="json"),
            },
        ),
        duration_s=float(flown.time_s[-1]),
        lines=lines,
        engaged=((0.0, float(flown.time_s[-1])),),
        events=tuple(events),
        remarks=failed,
    )
