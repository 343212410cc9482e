"""What several of these tests check against."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from msgspec import Struct
from msgspec.structs import astuple
from numpy.typing import NDArray
from scipy.linalg import expm

from kffa_offboard.control.covariance import Covariance
from kffa_offboard.control.kalman import KalmanParameters
from kffa_offboard.control.observer import PlantModel

Model = Callable[[KalmanParameters, PlantModel, int, float], tuple[NDArray, NDArray]]


@pytest.fixture(scope="session")
def exact_model() -> Model:
    """The Kalman filter's F and Q ``(states, states)`` of a channel, by the matrix exponential (Van Loan)."""

    def model_over(
        parameters: KalmanParameters, model: PlantModel, channel: int, dt: float
    ) -> tuple[NDArray, NDArray]:
        n, damping = parameters.states, float(model.damping[channel])
        a = np.array([[0.0, 1.0, 0.0], [0.0, -damping, 1.0], [0.0, 0.0, 0.0]])
        noise = np.zeros((3, 3))
        noise[2, 2] = parameters.disturbance_intensity[channel]
        whole = expm(np.block([[-a, noise], [np.zeros((3, 3)), a.T]]) * dt)
        f = whole[3:, 3:].T
        return (f, f @ whole[:3, 3:]) if n == 3 else (f[:2, :2], 0.03 * np.eye(2))

    return model_over


@pytest.fixture(scope="session")
def leaves() -> Callable[[Any], NDArray]:
    """All numbers of a state or an output, flat, whether of one vehicle or of a batch of one."""

    def flat(value: Any) -> NDArray:
        if isinstance(value, Struct):
            value = astuple(value)
        if isinstance(value, tuple):
            return np.concatenate([flat(part) for part in value]) if value else np.empty(0)
        if isinstance(value, Covariance):
            value = value.matrix
        return np.empty(0) if value is None else np.asarray(value, dtype=float).reshape(-1)

    return flat
