"""Bilinear interpolation is the 49 rules; the rule bases have the symmetry that is claimed for them."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.control import fuzzy

CENTRES = np.linspace(-4.0, 4.0, 7)


def triangle(x: float, k: int) -> float:
    """Membership of set k: one at its centre, zero at the neighbours', saturating at the edges."""
    x = float(np.clip(x, -4.0, 4.0))
    return max(0.0, 1.0 - abs(x - CENTRES[k]) / (CENTRES[1] - CENTRES[0]))


def all_rules(table: np.ndarray, e: float, ec: float) -> float:
    """Eq 40 as it is printed: 49 products over their sum."""
    weights = [
        (triangle(e, i) * triangle(ec, j), table[i, j]) for i, j in itertools.product(range(7), range(7))
    ]
    return sum(w * y for w, y in weights) / sum(w for w, _ in weights)


@pytest.mark.parametrize("rules", ["published", "even"])
@given(e=st.floats(-6.0, 6.0), ec=st.floats(-6.0, 6.0))
def test_interpolation_equals_the_sum_over_49_rules(rules: str, e: float, ec: float) -> None:
    table = fuzzy.TABLES[rules]
    assert float(fuzzy.infer(table, np.array(e), np.array(ec))) == pytest.approx(
        all_rules(table, e, ec), abs=1e-12
    )


def test_the_restored_table_contains_every_printed_row_in_order() -> None:
    printed = {
        "NB": "PB PB PB PS ZO ZO",
        "NM": "PB PB PM PM PS ZO",
        "NS": "PM PM PS PS ZO ZO",
        "ZO": "PM PS PS ZO NS NS",
        "PS": "PS ZO ZO NS NM NM",
        "PM": "ZO ZO NS NM NM NB",
        "PB": "ZO NS NM NM NB NB",
    }
    names = dict(zip(np.round(CENTRES, 9), ["NB", "NM", "NS", "ZO", "PS", "PM", "PB"], strict=True))
    for row, entries in zip(fuzzy.PUBLISHED, printed.values(), strict=True):
        restored = iter([names[round(float(value), 9)] for value in row])
        assert all(entry in restored for entry in entries.split()), entries


def test_the_published_rules_are_odd_up_to_the_one_cell_that_no_choice_can_mend() -> None:
    mirrored = -fuzzy.PUBLISHED[::-1, ::-1]
    odd = np.argwhere(~np.isclose(fuzzy.PUBLISHED, mirrored))
    assert odd.tolist() == [[0, 2], [6, 4]]  # NB row, NS column, and its mirror
    assert np.all(np.diff(fuzzy.PUBLISHED, axis=0) <= 1e-12)
    assert np.all(np.diff(fuzzy.PUBLISHED, axis=1) <= 1e-12)


@given(e=st.floats(-5.0, 5.0), ec=st.floats(-5.0, 5.0))
def test_the_even_rules_treat_up_and_down_alike(e: float, ec: float) -> None:
    up = fuzzy.infer(fuzzy.EVEN, np.array(e), np.array(ec))
    down = fuzzy.infer(fuzzy.EVEN, np.array(-e), np.array(-ec))
    assert up == pytest.approx(down, abs=1e-12)


def test_a_step_up_raises_the_bandwidth_and_a_step_down_only_with_even_rules() -> None:
    for rules, down_sign in (("published", -1.0), ("even", 1.0)):
        parameters = fuzzy.FuzzyParameters(np.ones(1), np.ones(1), np.full(1, 4.0), rules)
        up = fuzzy.bandwidth_correction(parameters, np.array([-1.0]), np.zeros(1))
        down = fuzzy.bandwidth_correction(parameters, np.array([1.0]), np.zeros(1))
        assert up[0] > 2.0
        assert np.sign(down[0]) == down_sign


def test_the_correction_stays_within_its_range_for_any_input() -> None:
    grid = np.linspace(-1e6, 1e6, 41)
    e, ec = np.meshgrid(grid, grid)
    for table in fuzzy.TABLES.values():
        assert np.max(np.abs(fuzzy.infer(table, e, ec))) <= fuzzy.UNIVERSE + 1e-12
