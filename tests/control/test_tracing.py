"""Array code written out as straight code: the same numbers, NaN included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kffa_offboard.control.tracing import Tape, compiled, take_columns

TABLE = np.arange(12.0).reshape(2, 6) ** 1.5

#: Each of two arrays (3,).
CALCULATIONS = {
    "arithmetic": lambda a, b: (a + 2.0 * b - 1.5) / 3.0 - -a * b,
    "constants that need no operation": lambda a, b: 1.0 * a + 0.0 + b * 1.0 - 0.0 + a / 1.0,
    "limits": lambda a, b: np.minimum(np.maximum(a, b - 1.0), 2.0),
    "functions": lambda a, b: np.sqrt(np.abs(a)) + np.copysign(2.0, b) + a * a,
    "whole numbers": lambda a, b: np.rint(a) - np.rint(0.5 * b),
    "choice": lambda a, b: np.where(a <= b, a, np.where(b > 1.0, b, 0.0)),
    "rows": lambda a, b: np.stack([a, b])[1] * np.stack([b, a])[1],
}


def written_out(function):
    tape = Tape()
    inputs = {"a": tape.inputs("a_", (3,)), "b": tape.inputs("b_", (3,))}
    straight = compiled(tape, inputs, [function(*inputs.values())])
    return lambda a, b: np.array(straight(a.tolist(), b.tolist()))


NUMBERS = st.lists(
    st.one_of(st.floats(-1e6, 1e6), st.sampled_from([0.0, -0.0, 0.5, 1.5, 2.5, np.nan, np.inf, -np.inf])),
    min_size=3,
    max_size=3,
).map(np.array)


@pytest.mark.parametrize("name", CALCULATIONS)
@given(a=NUMBERS, b=NUMBERS)
def test_the_function_says_what_numpy_says(name, a, b):
    function = CALCULATIONS[name]
    with np.errstate(all="ignore"):
        expected = function(a, b)
    np.testing.assert_array_equal(written_out(function)(a, b), expected)


@given(a=st.lists(st.floats(0.0, 5.0), min_size=3, max_size=3).map(np.array))
def test_columns_of_a_table(a):
    def function(a, b):
        corner, slope = take_columns(TABLE, np.minimum(a.astype(np.intp), 5))
        return corner + slope * b

    np.testing.assert_array_equal(written_out(function)(a, a), function(a, a))


def test_what_is_used_twice_is_worked_out_once():
    tape = Tape()
    a = tape.inputs("a_", (1,))
    root = np.sqrt(a)
    source = compiled(tape, {"a": a}, [root + 1.0, root * root, np.sqrt(a)]).__doc__
    assert source.count("sqrt(") == 1


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b: a if a[0] > 0.0 else b,
        lambda a, b: np.exp(a),
        lambda a, b: np.add.reduce(a),
        lambda a, b: np.linalg.norm(a),
        lambda a, b: a * float(b[0]),
        lambda a, b: a.astype(np.float32),
        lambda a, b: np.mean(a),
    ],
    ids=["branch", "exp", "reduce", "norm", "float", "float32", "mean"],
)
def test_what_cannot_be_written_out_is_refused_while_tracing(function):
    with pytest.raises(TypeError):
        written_out(function)
