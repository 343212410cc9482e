"""The control law: pure mathematics, arrays in and arrays out; no I/O, no clock, no MAVLink.

Every function takes arrays whose first axis is the channel (roll, pitch, yaw, altitude) and
whose last axis may be a batch of flights: ``(4,)`` is one vehicle, ``(4, 10000)`` ten thousand.
State is a frozen value; a block is ``step(parameters, state, inputs, dt) -> (state, outputs)``.
"""

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
BoolArray: TypeAlias = NDArray[np.bool_]


def column(value: float | Array | BoolArray, like: Array) -> Any:
    """Shape a scalar, a per-channel vector ``(4,)`` or a full array so that it broadcasts against `like`.

    A per-channel vector gets one trailing axis for each batch axis of `like`.
    """
    array = value if isinstance(value, np.ndarray) else np.asarray(value)
    if array.ndim == 0 or array.ndim >= like.ndim:
        return array
    return array.reshape(array.shape + (1,) * (like.ndim - array.ndim))
