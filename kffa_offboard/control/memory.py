"""Remembering what depends on parameters and step times alone.

A flight takes steps of a few different lengths with one set of parameters; the exact discretisation of a
block is worked out once for each and looked up from then on. The functions stay pure.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np

REMEMBERED = 256
"""Results that one function keeps; beyond it the oldest is forgotten."""

LARGEST = 1024
"""Entries of an array that still counts: what belongs to a batch of many flights is worked out each time."""

P = ParamSpec("P")
R = TypeVar("R", bound=tuple[Any, ...])


def _value(array: np.ndarray[Any, Any]) -> Any:
    """What stands for an array in a key; a large one is like no other."""
    return (array.tobytes(), array.shape, array.dtype.char) if array.size <= LARGEST else object()


def remember(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the last results of a pure function that returns a tuple, of arrays for instance.

    Arguments go by position. Arrays count by value, everything else as it hashes: dataclasses of parameters,
    with ``eq=False``, by identity. Nobody may write into a result.
    """
    results: dict[Any, R] = {}

    @wraps(function)
    def recall(*args: P.args, **kwargs: P.kwargs) -> R:
        key = tuple([_value(a) if type(a) is np.ndarray else a for a in args])
        known = results.get(key)
        if known is not None:
            return known
        result = function(*args, **kwargs)
        # A key with a large array is never found again: that result is not kept either.
        for value in (*args, *result):
            if type(value) is np.ndarray and value.size > LARGEST:
                return result
        if len(results) >= REMEMBERED:
            del results[next(iter(results))]
        results[key] = result
        return result

    return recall
