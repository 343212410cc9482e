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
"""Results that one function keeps; beyond it the one that was not asked for the longest is forgotten."""

LARGEST = 1024
"""Entries of an array that still counts: what belongs to a batch of many flights is worked out each time."""

P = ParamSpec("P")
R = TypeVar("R", bound=tuple[Any, ...])


def remember(function: Callable[P, R]) -> Callable[P, R]:
    """Keep the last results of a pure function that returns a tuple, of arrays for instance.

    Arguments go by position. Arrays count by value, everything else as it hashes:
    dataclasses of parameters, with ``eq=False``, by identity. Nobody may write into a result.
    """
    results: dict[Any, R] = {}

    @wraps(function)
    def recall(*args: P.args, **kwargs: P.kwargs) -> R:
        parts: list[Any] = []
        for value in args:
            if type(value) is np.ndarray:
                if value.size > LARGEST:
                    return function(*args, **kwargs)
                parts.append((value.tobytes(), value.shape, value.dtype.char))
            else:
                parts.append(value)
        key = tuple(parts)
        known = results.pop(key, None)
        if known is not None:
            results[key] = known  # as the latest
            return known
        result = function(*args, **kwargs)
        for value in result:
            if type(value) is np.ndarray and value.size > LARGEST:
                return result
        if len(results) >= REMEMBERED:
            del results[next(iter(results))]
        results[key] = result
        return result

    return recall
