"""Flights of a campaign as one batch: hover, pick-up, drop, on the airframe with the daemon's control law.

A batch always has `WIDTH` columns, however few flights are asked for; spare ones repeat the last flight. With
the same shapes every flight goes through the same machine instructions, so its figures are the same to the
last bit, alone or among others (on machines of one kind, with one version of numpy).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from kffa_offboard.campaign.conditions import Conditions, Surroundings, draw
from kffa_offboard.campaign.measure import Observation, Outcomes
from kffa_offboard.campaign.settings import Campaign
from kffa_offboard.control import Array, BoolArray, controllers
from kffa_offboard.control.controllers import ControllerName
from kffa_offboard.experiments import airframe, inner_loop, plant

WIDTH = 2000
"""Flights of a batch: wide enough for numpy, and ten thousand are work for five processes."""

STEP_S = airframe.STEP_S

Record = TypeVar("Record", Conditions, Outcomes)


@dataclass(frozen=True)
class Moment:
    """One control step of a batch: true state `rigid` ``(12, N)``, the rest ``(4, N)`` in channel order."""

    time: float
    rigid: Array
    load_kg: Array
    reference: Array
    measured: Array
    output: controllers.ControllerOutput


def fly(
    campaign: Campaign,
    controller: ControllerName,
    numbers: NDArray[np.int64],
    width: int = WIDTH,
    watch: Callable[[Moment], None] | None = None,
) -> tuple[Conditions, Outcomes]:
    """Fly the flights `numbers` ``(N,)``, N at most `width`, with one controller; results have N columns."""
    padded = np.concatenate([numbers, np.repeat(numbers[-1:], width - len(numbers))])
    batch = Batch(campaign, controller, padded)
    for k in range(campaign.steps):
        batch.step(k * campaign.control_s, watch)
    outcomes = batch.observation.outcomes()
    return _first(batch.conditions, len(numbers)), _first(outcomes, len(numbers))


def _first(record: Record, count: int) -> Record:
    return type(record)(**{name: values[:count] for name, values in vars(record).items()})


class _DelayLine:
    """What was pushed a while ago; another while for each flight, in steps of the vehicle."""

    def __init__(self, rows: Array, delay_s: Array, extra: int = 0) -> None:
        """`rows` ``(R, N)`` have been there for ever; `extra` is the most beyond `delay_s` ``(N,)``."""
        late = np.rint(delay_s / STEP_S).astype(np.int64)
        self._longest = int(late.max())
        self._depth = self._longest + extra + 1
        # Everything twice, one depth apart, so that what lies behind the newest is never cut in two.
        self._held = np.repeat(rows[None], 2 * self._depth, axis=0)
        self._place = np.arange(rows.size).reshape(rows.shape) + (self._longest - late) * rows.size
        self._newest = 0

    def push(self, rows: Array) -> None:
        """At every step of the vehicle."""
        self._newest = (self._newest + 1) % self._depth
        self._held[self._newest] = self._held[self._newest + self._depth] = rows

    def read(self, rows: slice = slice(None), extra: int = 0) -> Array:
        """What has arrived by now of the chosen rows, `extra` steps later than the rest."""
        latest = self._newest + self._depth - extra
        return self._held[latest - self._longest :].reshape(-1).take(self._place[rows])


class Batch:
    """All flights of a batch, step by step.

    Attributes
    ----------
    conditions : of each flight
    observation : what came out so far
    """

    def __init__(self, campaign: Campaign, controller: ControllerName, numbers: NDArray[np.int64]) -> None:
        """In a steady hover without load, as if a patient pilot had handed over."""
        file, count = campaign.file, len(numbers)
        self.conditions = conditions = draw(file, numbers)
        self._service = service = campaign.services[controller]
        self._vehicle = file.vehicle
        self._dt = campaign.control_s
        self._substeps = round(campaign.control_s / STEP_S)
        self._target = file.flight.altitude_m
        self._pickup_s = file.flight.settle_s
        self._drop_s = conditions.drop_after_s + self._pickup_s
        self.observation = Observation(file.failed, self._pickup_s, self._drop_s, self._dt)
        hover = service.hover_thrust * (1.0 + conditions.hover_thrust_error)
        self._full_thrust = plant.MASS * plant.GRAVITY / hover
        below = np.full(count, -file.vehicle.load_below_m)
        self._offset = np.stack([conditions.offset_x_m, conditions.offset_y_m, below])
        self._rigid = np.zeros((12, count))
        self._rigid[2] = self._target
        self._motors = np.full((4, count), plant.MASS * plant.GRAVITY / 4.0)
        self._loop = airframe.RateLoop(*3 * (np.zeros((3, count)),))
        self._reference = np.zeros((4, count))
        self._reference[3] = self._target
        self._control = self._started(hover)
        setpoint = np.concatenate([np.zeros((3, count)), hover[None]])
        self._sent = setpoint
        self._uplink = _DelayLine(self._measurable(), conditions.link_delay_s, self._substeps)
        self._downlink = _DelayLine(setpoint, conditions.link_delay_s)
        self._surroundings = Surroundings(file, conditions, numbers, self._dt)
        self._carried: BoolArray = np.zeros(count, dtype=bool)
        self._body = self._loaded()

    def _started(self, hover: Array) -> controllers.ControllerState:
        """A controller that has found the balance; a PID's integral holds it, too."""
        parameters = self._service.controller
        balance = np.concatenate([np.zeros((3, len(hover))), hover[None]])
        state = controllers.initial_state(parameters, self._reference, balance)
        # One age of the last measurement for the whole batch, so that the gains are worked out once.
        state = replace(state, observer=replace(state.observer, elapsed=np.zeros((4, 1))))
        return controllers.align_reference(parameters, state)

    def _measurable(self) -> Array:
        """What the autopilot knows, in the order of the noise's rows."""
        return self._rigid.take((6, 7, 8, 9, 10, 11, 2, 5), axis=0)

    def _loaded(self) -> airframe.Body:
        return airframe.body(
            np.where(self._carried, self.conditions.load_kg, 0.0),
            self._vehicle.drag_n_s_m,
            self._offset,
            self._full_thrust,
            self.conditions.motor_lag_s,
        )

    def step(self, time: float, watch: Callable[[Moment], None] | None = None) -> None:
        """One control step at `time`, and the vehicle's steps until the next one."""
        carried = (time >= self._pickup_s - 1e-9) & (time < self._drop_s - 1e-9)
        if (carried != self._carried).any():
            self._carried = carried
            self._body = self._loaded()
        noise, wind = self._surroundings.step()
        attitude = self._uplink.read(slice(0, 6)) + noise[:6]
        # Position messages come right after the attitude that starts a step, so they are one period older.
        height = self._uplink.read(slice(6, 8), self._substeps) + noise[6:]
        self._control, output, setpoint = inner_loop.step(
            self._service.controller,
            self._control,
            self._reference,
            inner_loop.Telemetry(attitude[:3], attitude[3:], height[0], height[1]),
            self._service.limits.tilt_compensation_max_rad,
            self._dt,
        )
        self._sent = np.concatenate([setpoint.body_rates, setpoint.thrust[None]])
        if watch is not None:
            measured = np.concatenate([attitude[:3], height[:1]])
            load = np.where(self._carried, self.conditions.load_kg, 0.0)
            watch(Moment(time, self._rigid, load, self._reference, measured, output))
        self._see(time, output)
        for _ in range(self._substeps):
            self._move(wind)

    def _move(self, wind: Array) -> None:
        """One step of the vehicle."""
        self._downlink.push(self._sent)
        setpoint = self._downlink.read()
        # The gyro of the rate loop: nothing on the way, and its noise is the autopilot's own affair.
        self._loop, torque = airframe.rate_loop(self._loop, setpoint[:3], self._rigid[9:12])
        commands = airframe.mix(setpoint[3], torque)
        self._rigid, self._motors = airframe.step(
            self._rigid, self._motors, commands, self._body, wind, STEP_S, "midpoint"
        )
        self._uplink.push(self._measurable())

    def _see(self, time: float, output: controllers.ControllerOutput) -> None:
        rigid = self._rigid
        cosine = np.cos(rigid[6]) * np.cos(rigid[7])
        self.observation.see(time, rigid[2], rigid[2] - self._target, cosine, output.saturated[3])
        lost = self.observation.lost
        if lost.any():
            # Whatever it would still do is nobody's business, as long as it stays finite.
            self._rigid[:, lost] = 0.0
            self._rigid[2, lost] = self._target
