"""Examples 1-4 as flights, and the flying: every controller flies all its flights as one batch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from kffa_offboard.control import Array, BoolArray
from kffa_offboard.experiments import settings as paper
from kffa_offboard.experiments.flights import STEP_S, Flights, Record, fly
from kffa_offboard.experiments.settings import PaperSettings, Variant

POSITION: Final = "position"
Example = int | Literal["position"]
EXAMPLES = (1, 2, 3, 4)
#: The paper's examples, and the position ring, which it has no example of (`position_flights`).
EVERYTHING: tuple[Example, ...] = (*EXAMPLES, POSITION)
LOADED_STEP = "3/loaded-step"
LOADS = ("load", "load-inertia", "limit", "limit-inertia")
DISTURBANCES = ("load", "wind")


@dataclass(frozen=True)
class Flight:
    """One flight of one example.

    Attributes
    ----------
    name : such as ``1/up``, ``3/limit-inertia``, ``4/wind/7`` (the last is the seed)
    reference : (T, 4)
    load_mass, vertical : (T,)
    noise : (T, 4)
    """

    name: str
    reference: Array
    load_mass: Array
    load_inertia: bool
    vertical: Array
    noise: Array

    @property
    def example(self) -> int:
        """Number of the example."""
        return int(self.name[0])


@dataclass(frozen=True)
class Trace:
    """One flight of one controller; each ``(T, 4)`` in channel order, output true."""

    time: Array
    reference: Array
    output: Array
    command: Array
    omega_c: Array

    @property
    def error(self) -> Array:
        """Reference minus true output."""
        return self.reference - self.output


Traces = dict[tuple[str, str], Trace]  # by variant's label and flight's name


def _times(duration_s: float) -> Array:
    return np.asarray(STEP_S * np.arange(round(duration_s / STEP_S)), dtype=np.float64)


def _flight(
    name: str,
    reference: Array,
    load_mass: Array | None = None,
    load_inertia: bool = False,
    vertical: Array | None = None,
    noise: Array | None = None,
) -> Flight:
    """A flight in which only what is given happens."""
    nothing = np.zeros(len(reference))
    return Flight(
        name,
        reference,
        nothing if load_mass is None else load_mass,
        load_inertia,
        nothing if vertical is None else vertical,
        np.zeros_like(reference) if noise is None else noise,
    )


def _steps(settings: PaperSettings) -> list[Flight]:
    step = np.array(settings.examples.step)
    ones = np.ones((len(_times(settings.examples.step_duration_s)), 1))
    return [_flight("1/up", ones * step), _flight("1/down", -ones * step)]


def triangle(time: Array, period: float) -> Array:
    """Triangle wave from 0 to 1 and back in `period` s, at `time` ``(T,)``."""
    phase = np.mod(time, period) / period
    return np.asarray(1.0 - np.abs(2.0 * phase - 1.0))


def _triangles(settings: PaperSettings) -> list[Flight]:
    told = settings.examples
    time = _times(told.triangle_period_s * told.triangle_cycles)
    return [_flight("2/triangle", triangle(time, told.triangle_period_s)[:, None] * np.array(told.step))]


def _hold(settings: PaperSettings) -> tuple[Array, Array, BoolArray]:
    """Time, constant reference and whether the load hangs, of Examples 3 and 4."""
    told = settings.examples
    time = _times(told.duration_s)
    hanging = (time >= told.load_on_s - 1e-9) & (time < told.load_off_s - 1e-9)
    return time, np.ones((len(time), 1)) * np.array(told.step), hanging


def _loads(settings: PaperSettings) -> list[Flight]:
    """The load comes and goes at rest; and Example 1's step under the largest load, where inertia acts."""
    _, reference, hanging = _hold(settings)
    told = settings.examples
    step = _steps(settings)[0].reference
    largest = np.full(len(step), told.load_limit_kg)
    loaded_step = _flight(LOADED_STEP, step, load_mass=largest, load_inertia=True)
    return [loaded_step] + [
        _flight(
            f"3/{name}",
            reference,
            load_mass=np.where(
                hanging, told.load_limit_kg if name.startswith("limit") else told.load_kg, 0.0
            ),
            load_inertia=name.endswith("inertia"),
        )
        for name in LOADS
    ]


def _noisy(settings: PaperSettings, seeds: int) -> list[Flight]:
    time, reference, hanging = _hold(settings)
    told = settings.examples
    wind = np.asarray(told.wind_amplitude_m_s2 * np.sin(time))
    flights = []
    for seed in range(seeds):
        noise = np.random.default_rng(seed).normal(0.0, told.noise_std, reference.shape)
        flights += [
            _flight(f"4/load/{seed}", reference, load_mass=np.where(hanging, told.load_kg, 0.0), noise=noise),
            _flight(f"4/wind/{seed}", reference, vertical=wind, noise=noise),
        ]
    return flights


def flights_of(settings: PaperSettings, example: int, seeds: int) -> list[Flight]:
    """The flights of one example; `seeds` is read by Example 4 only."""
    if example == 1:
        return _steps(settings)
    if example == 2:
        return _triangles(settings)
    return _loads(settings) if example == 3 else _noisy(settings, seeds)


def stack(flights: Sequence[Flight]) -> Flights:
    """One batch of flights of different length; the shorter ones go on as they end."""
    steps = max(len(flight.reference) for flight in flights)

    def extended(values: Array) -> Array:
        missing = steps - len(values)
        return np.concatenate([values, np.repeat(values[-1:], missing, axis=0)]) if missing else values

    return Flights(
        reference=np.stack([extended(flight.reference) for flight in flights], axis=-1),
        load_mass=np.stack([extended(flight.load_mass) for flight in flights], axis=-1),
        load_inertia=np.array([flight.load_inertia for flight in flights]),
        vertical=np.stack([extended(flight.vertical) for flight in flights], axis=-1),
        noise=np.stack([extended(flight.noise) for flight in flights], axis=-1),
    )


def unstack(record: Record, flights: Sequence[Flight]) -> list[Trace]:
    """The flights of a batch one by one, each as long as it was meant to be."""
    traces = []
    for column, flight in enumerate(flights):
        shown = (slice(0, len(flight.reference)), slice(None), column)
        traces.append(
            Trace(
                record.time[shown[0]],
                flight.reference,
                record.output[shown],
                record.command[shown],
                record.omega_c[shown],
            )
        )
    return traces


def plan(settings: PaperSettings, examples: Sequence[int], seeds: int) -> list[tuple[Variant, list[Flight]]]:
    """Which controller flies which flights. With the TD, the steps; LADRC and FA-LADRC the triangle, too."""
    flights = [flight for example in examples for flight in flights_of(settings, example, seeds)]
    planned = [(variant, flights) for variant in (*paper.MAIN, *paper.OTHER_READINGS)]
    for variant in paper.WITH_DIFFERENTIATOR:
        shown = (1, 2) if variant.name in ("ladrc", "fa-ladrc") else (1,)
        if tracked := [flight for flight in flights if flight.example in shown]:
            planned.append((variant, tracked))
    return planned


def steps_of(planned: Sequence[tuple[Variant, list[Flight]]]) -> int:
    """Number of simulation steps that a plan takes, for progress."""
    return sum(max(len(flight.reference) for flight in flights) for _, flights in planned)


def fly_all(
    settings: PaperSettings,
    planned: Sequence[tuple[Variant, list[Flight]]],
    tick: Callable[[str, int], None] = lambda label, steps: None,
) -> Traces:
    """Fly a plan. `tick` is told the controller's label and the steps done since its last call."""
    traces: Traces = {}
    for variant, flights in planned:
        label = variant.label

        def flown(steps: int, label: str = label) -> None:
            tick(label, steps)

        record = fly(paper.controller(settings, variant), stack(flights), flown)
        for flight, trace in zip(flights, unstack(record, flights), strict=True):
            traces[label, flight.name] = trace
    return traces
