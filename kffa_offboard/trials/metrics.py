"""How well a flight went, measured on the true states of the simulator, not on anybody's estimate."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COLUMNS = ("time_s", "x", "y", "z", "roll", "pitch", "yaw", "thrust_n", "load_mass_kg")

WINDOW_S = 5.0
"""Length of the window after a pick-up or drop, and of the steady hover before the pick-up."""

LANDING_DEPTH_M = 0.1
"""Landing has begun where the vehicle is this far below the target for the last time."""

LIFTOFF_HEIGHT_M = 0.05


class FlightFailed(Exception):
    """The flight did not go as it should: one line with the reason."""


@dataclass(frozen=True)
class Truth:
    """True states of one flight, one row each 10 ms of simulated time; arrays ``(n,)``, SI units, radians.

    Attributes
    ----------
    time_s : simulated time since power-up
    x, y : north and west of where it took off
    z : height above the ground
    roll, pitch, yaw : attitude
    thrust_n : total thrust of the motors
    load_mass_kg : what hangs below
    events : (time_s, text), as the simulator tells them
    """

    time_s: Array
    x: Array
    y: Array
    z: Array
    roll: Array
    pitch: Array
    yaw: Array
    thrust_n: Array
    load_mass_kg: Array
    events: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Deviation:
    """What a pick-up or drop did in the 5 s after it: largest and integrated distance from the target."""

    peak_m: float
    iae_m_s: float


@dataclass(frozen=True)
class PlaceMetrics:
    """How well the place was held and the way flown; horizontal, m.

    Attributes
    ----------
    hover_rms_m : rms distance from where it took off, in the last 5 s before the pick-up
    pickup_peak_m, drop_peak_m : largest such distance in the 5 s after each
    path_peak_m : largest distance from the line of the moves, from 5 s after the drop until landing begins
    """

    hover_rms_m: float
    pickup_peak_m: float
    drop_peak_m: float
    path_peak_m: float


@dataclass(frozen=True)
class FlightMetrics:
    """The figures of one flight.

    Attributes
    ----------
    pickup, drop : deviation of height
    hover_rms_m : rms distance from the target in the last 5 s before the pick-up
    attitude_rms_rad : rms of roll and pitch from there until landing begins; with moves, until 5 s after
        the drop
    pickup_s, drop_s, liftoff_s, landing_s : when, in simulated time
    place : None where no place was to be held
    """

    pickup: Deviation
    drop: Deviation
    hover_rms_m: float
    attitude_rms_rad: float
    liftoff_s: float
    pickup_s: float
    drop_s: float
    landing_s: float
    place: PlaceMetrics | None = None


def read_truth(path: Path) -> Truth:
    """Read the CSV that ``sim-vehicle run --truth`` writes.

    Raises FlightFailed if there is no file or no flight in it.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError as error:
        raise FlightFailed(f"the simulator wrote no true states to {path}") from error
    if rows and None in rows[-1].values():  # the last line of a file that is still being written
        rows.pop()
    if not rows:
        raise FlightFailed(f"{path} holds no true states")
    columns = {name: np.array([float(row[name]) for row in rows]) for name in COLUMNS}
    events = tuple((float(row["time_s"]), row["event"]) for row in rows if row["event"])
    return Truth(**columns, events=events)


def measure(truth: Truth, target_m: float, corners: Array | None = None) -> FlightMetrics:
    """Measure a flight that was to hold `target_m` and, if given, its place.

    `corners` (K, 2) are the ends of the moves, m north and west of where it took off, which is the first one.
    Raises FlightFailed if nothing was picked up or dropped in the air, or too early for a hover before.
    """
    liftoff_s, pickup_s, drop_s = _liftoff(truth), *_load_changes(truth)
    if pickup_s - WINDOW_S < liftoff_s:
        raise FlightFailed(
            f"picked up {pickup_s - liftoff_s:.1f} s after lift-off: no steady hover before it"
        )
    landing_s = _landing(truth, target_m, drop_s)
    error = truth.z - target_m
    hover = _during(truth, pickup_s - WINDOW_S, pickup_s)
    steady = _during(truth, pickup_s - WINDOW_S, landing_s if corners is None else drop_s + WINDOW_S)
    return FlightMetrics(
        pickup=_deviation(truth, error, pickup_s),
        drop=_deviation(truth, error, drop_s),
        hover_rms_m=_rms(error[hover]),
        attitude_rms_rad=_rms(np.concatenate([truth.roll[steady], truth.pitch[steady]])),
        liftoff_s=liftoff_s,
        pickup_s=pickup_s,
        drop_s=drop_s,
        landing_s=landing_s,
        place=None if corners is None else _place(truth, corners, pickup_s, drop_s, landing_s),
    )


def _place(truth: Truth, corners: Array, pickup_s: float, drop_s: float, landing_s: float) -> PlaceMetrics:
    away = np.hypot(truth.x - corners[0, 0], truth.y - corners[0, 1])
    moving = _during(truth, drop_s + WINDOW_S, landing_s)
    if not moving.any():
        raise FlightFailed("the vehicle landed right after the drop: no moves")
    path = distance_from_path(np.column_stack([truth.x, truth.y])[moving], corners)
    return PlaceMetrics(
        hover_rms_m=_rms(away[_during(truth, pickup_s - WINDOW_S, pickup_s)]),
        pickup_peak_m=float(away[_during(truth, pickup_s, pickup_s + WINDOW_S)].max()),
        drop_peak_m=float(away[_during(truth, drop_s, drop_s + WINDOW_S)].max()),
        path_peak_m=float(path.max()),
    )


def distance_from_path(places: Array, corners: Array) -> Array:
    """Distance (T,) of `places` (T, 2) from the nearest point of the line through `corners` (K, 2)."""
    distances = []
    for start, end in pairwise(corners):
        side = end - start
        share = np.clip((places - start) @ side / (side @ side), 0.0, 1.0)
        distances.append(np.hypot(*(places - start - share[:, None] * side).T))
    return np.asarray(np.min(distances, axis=0))


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _during(truth: Truth, start_s: float, end_s: float) -> NDArray[np.bool_]:
    return np.asarray((truth.time_s >= start_s) & (truth.time_s < end_s))


def _deviation(truth: Truth, error: Array, event_s: float) -> Deviation:
    window = _during(truth, event_s, event_s + WINDOW_S)
    if truth.time_s[-1] < event_s + WINDOW_S:
        raise FlightFailed(f"the flight ended {truth.time_s[-1] - event_s:.1f} s after a change of load")
    distance = np.abs(error[window])
    return Deviation(float(distance.max()), float(np.trapezoid(distance, truth.time_s[window])))


def _liftoff(truth: Truth) -> float:
    above = truth.z > LIFTOFF_HEIGHT_M
    if not above.any():
        raise FlightFailed("the vehicle did not leave the ground")
    return float(truth.time_s[np.argmax(above)])


def _load_changes(truth: Truth) -> tuple[float, float]:
    """When a load was picked up, and when it was dropped."""
    change = np.diff(truth.load_mass_kg)
    more, less = np.flatnonzero(change > 0.0), np.flatnonzero(change < 0.0)
    if not more.size:
        raise FlightFailed("nothing was picked up")
    less = less[less > more[0]]
    if not less.size:
        raise FlightFailed("the load was not dropped")
    return float(truth.time_s[more[0] + 1]), float(truth.time_s[less[0] + 1])


def _landing(truth: Truth, target_m: float, drop_s: float) -> float:
    """When the vehicle was last at its target."""
    there = np.flatnonzero(truth.z > target_m - LANDING_DEPTH_M)
    if not there.size or truth.time_s[there[-1]] <= drop_s:
        raise FlightFailed("the vehicle did not stay at its height")
    return float(truth.time_s[there[-1]])
