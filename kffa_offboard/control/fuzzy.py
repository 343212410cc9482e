"""Fuzzy adaptation of the controller bandwidth: 49 rules (paper eq 38-42, Table 2).

Seven triangular sets that sum to one on each input, product inference and centre-average
defuzzification make eq 40 *bilinear interpolation* in the rule table, and it is implemented as that.

Differs from the paper in: Table 2 is printed with PM twice in its head and one entry of
every row lost; `PUBLISHED` is the restored table: each row holds its six printed entries in order,
rows and columns are monotone, and the five middle rows are antisymmetric, which fixes them
uniquely (NS and PS each follow from the other); NB and PB are the closest pair, one cell off.
The error is e = y - r (a step up starts in row NB and raises omega_c), the only sign with which
the paper's claims come out. The published rules are odd, so a step *down* lowers omega_c; `EVEN`
applies the same rules to the mirrored error instead, so that both directions get the same bandwidth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from kffa_offboard.control import Array, column
from kffa_offboard.control.memory import remember
from kffa_offboard.control.tracing import take_columns

UNIVERSE = 4.0  # the basic domain of e, its rate and the correction is -4..4 (paper, below eq 42)
SETS = 7  # NB NM NS ZO PS PM PB, centres evenly spaced over the universe

_NB, _NM, _NS, _ZO, _PS, _PM, _PB = np.linspace(-UNIVERSE, UNIVERSE, SETS)

#: Table 2, restored: rows are e from NB to PB, columns its rate from NB to PB.
PUBLISHED: Array = np.array(
    [
        [_PB, _PB, _PB, _PM, _PS, _ZO, _ZO],
        [_PB, _PB, _PM, _PM, _PS, _ZO, _ZO],
        [_PM, _PM, _PS, _PS, _ZO, _ZO, _NS],
        [_PM, _PS, _PS, _ZO, _NS, _NS, _NM],
        [_PS, _ZO, _ZO, _NS, _NS, _NM, _NM],
        [_ZO, _ZO, _NS, _NM, _NM, _NB, _NB],
        [_ZO, _ZO, _NS, _NM, _NM, _NB, _NB],
    ]
)
PUBLISHED.setflags(write=False)


def _even_table() -> Array:
    """Rows of negative e as published, mirrored onto positive e; on the ZO row the mean of both readings."""
    mirrored = PUBLISHED[::-1, ::-1]
    middle = SETS // 2
    table = np.concatenate(
        [
            PUBLISHED[:middle],
            (PUBLISHED[middle : middle + 1] + mirrored[middle : middle + 1]) / 2.0,
            mirrored[middle + 1 :],
        ]
    )
    table.setflags(write=False)
    return table


EVEN: Array = _even_table()

RuleBase = Literal["published", "even"]
TABLES: dict[RuleBase, Array] = {"published": PUBLISHED, "even": EVEN}


@dataclass(frozen=True, eq=False)
class FuzzyParameters:
    """Scaling of the rule base; each entry ``(4,)`` or ``(4, N)``.

    Attributes
    ----------
    error_scale : output units that make e reach the edge of the universe
    error_rate_scale : output units per second that make its rate reach the edge
    omega_c_range : rad/s added to omega_c by PB (and taken by NB)
    rules : which of the two rule bases
    """

    error_scale: Array
    error_rate_scale: Array
    omega_c_range: Array
    rules: RuleBase = "even"


def infer(table: Array, e: Array, ec: Array) -> Array:
    """Output of the 49 rules (eq 40) for normalised inputs on -4..4; outside they saturate.

    Parameters
    ----------
    table : (7, 7) rule consequents, rows e, columns its rate
    e, ec : (4[, N]) normalised error and error rate
    """
    return _interpolate(table, np.stack([e, ec]) / _SPACING)


_SPACING = 2.0 * UNIVERSE / (SETS - 1)


@remember
def _patches(table: Array) -> tuple[Array]:
    """Bilinear surface of each cell, (4, 7 * 7): corner, slopes down and along, twist; flat as the table."""
    corner, below = table[:-1, :-1], table[1:, :-1]
    right, across = table[:-1, 1:], table[1:, 1:]
    patches = np.zeros((4, SETS, SETS))
    patches[:, :-1, :-1] = [corner, below - corner, right - corner, across - below - right + corner]
    return (patches.reshape(4, -1),)


def _interpolate(table: Array, place: Array) -> Array:
    """Bilinear interpolation at `place` ``(2, 4[, N])``: row and column, counted from the table's middle."""
    place = np.minimum(np.maximum(place + 0.5 * (SETS - 1.0), 0.0), SETS - 1.0)
    cell = np.minimum(place.astype(np.intp), SETS - 2)
    down, along = place - cell
    row, across = cell
    corner, per_row, per_column, twist = take_columns(_patches(table)[0], SETS * row + across)
    value: Array = corner + along * per_column + down * (per_row + along * twist)
    return value


@remember
def scaling(parameters: FuzzyParameters, axes: int) -> tuple[Array, Array]:
    """From error and rate ``(2, 4[, N])`` to places in the table, and from its entries to rad/s."""
    like = np.empty((1,) * axes)
    edges = np.array(
        np.broadcast_arrays(column(parameters.error_scale, like), column(parameters.error_rate_scale, like))
    )
    return UNIVERSE / _SPACING / edges, column(parameters.omega_c_range, like) / UNIVERSE


def bandwidth_correction(parameters: FuzzyParameters, error: Array, error_rate: Array) -> Array:
    """Delta omega_c [rad/s] for error e = y - r and its rate, each ``(4[, N])`` in output units."""
    return scaled_correction(parameters.rules, scaling(parameters, error.ndim), error, error_rate)


def scaled_correction(rules: RuleBase, scales: tuple[Array, Array], error: Array, error_rate: Array) -> Array:
    """`bandwidth_correction` with given `scaling`."""
    to_place, to_bandwidth = scales
    return _interpolate(TABLES[rules], np.stack([error, error_rate]) * to_place) * to_bandwidth
