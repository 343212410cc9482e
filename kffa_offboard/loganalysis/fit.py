"""Nonlinear least squares with honest confidence intervals.

The residuals of a flight are not white: gusts, and what the model leaves out, last longer than a sample.
The fit is therefore repeated through an autoregressive filter that whitens them (D. Cochrane and G. Orcutt,
"Application of least squares regression to relationships containing auto-correlated error terms", JASA 44,
1949), and what covariance they still have is estimated with them (W. Newey and K. West, "A simple, positive
semi-definite, heteroskedasticity and autocorrelation consistent covariance matrix", Econometrica 55, 1987).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.stats import t as student

from kffa_offboard.loganalysis.record import Array
from kffa_offboard.loganalysis.response import ResponseModel, Window

CONFIDENCE = 0.95
CORRELATION_S = 0.4
AR_ORDER = 8
_STARTING_DELAYS_S = (0.02, 0.05, 0.1, 0.2)
_EVALUATIONS = 60
_STEP = 1e-4  # of the numerical derivative, relative to the size of a parameter


@dataclass(frozen=True)
class Estimate:
    """A number with its 95 % confidence interval."""

    value: float
    low: float
    high: float

    @property
    def half_width(self) -> float:
        """Half the length of the interval."""
        return 0.5 * (self.high - self.low)


@dataclass(frozen=True)
class Fit:
    """Fitted parameters ``(p,)``, their covariance ``(p, p)``, and how well the model answers as the
    vehicle did.

    Attributes
    ----------
    explained : share of the output's variance that the command explains, beyond trim and initial state
    degrees : of freedom, for the quantile of the interval: stretches of two correlation times are independent
    """

    parameters: Array
    covariance: Array
    explained: float
    degrees: float

    def estimate(self, index: int) -> Estimate:
        """Parameter `index` with its interval."""
        return self.of(float(self.parameters[index]), float(np.sqrt(self.covariance[index, index])))

    def of(self, value: float, std: float) -> Estimate:
        """Interval of a value with a standard deviation."""
        width = float(student.ppf(0.5 + 0.5 * CONFIDENCE, self.degrees)) * std
        return Estimate(value, value - width, value + width)


def _project(basis: Array, values: Array) -> Array:
    """What of `values` ``(n[, p])`` the nuisance basis cannot make."""
    left, sizes, _ = np.linalg.svd(basis, full_matrices=False)
    left = left[:, sizes > 1e-9 * sizes[0]]
    return np.asarray(values - left @ (left.T @ values))


def _residual(model: ResponseModel, parameters: Array, window: Window, whitening: Array) -> Array:
    """What the model leaves of a window's output, through the whitening filter ``(order + 1,)``."""
    simulated, basis = model.predict(parameters, window)
    rest = lfilter(whitening, 1.0, window.output - simulated)
    order = len(whitening) - 1
    return _project(lfilter(whitening, 1.0, basis, axis=0)[order:], rest[order:])


def _whitening(residuals: list[Array]) -> Array:
    """Filter that makes the residuals white: an autoregression of `AR_ORDER` by least squares."""
    rows = [
        np.stack([rest[AR_ORDER - lag : len(rest) - lag] for lag in range(AR_ORDER + 1)], axis=1)
        for rest in residuals
    ]
    table = np.concatenate(rows)
    coefficients, *_ = np.linalg.lstsq(table[:, 1:], table[:, 0], rcond=None)
    return np.concatenate([[1.0], -coefficients])


def fit(model: ResponseModel, windows: list[Window]) -> Fit:
    """Fit the model to all windows at once."""
    scale = np.array(model.start)

    bounds = np.array(model.lower) / scale, np.array(model.upper) / scale
    starts = [np.array([*model.start[:-1], delay]) / scale for delay in _STARTING_DELAYS_S]
    whitening = np.ones(1)

    def parts(scaled: Array) -> list[Array]:
        return [_residual(model, scaled * scale, window, whitening) for window in windows]

    def residuals(scaled: Array) -> Array:
        return np.concatenate(parts(scaled))

    start = min(starts, key=lambda scaled: float(np.sum(residuals(scaled) ** 2)))
    best = least_squares(residuals, start, bounds=bounds, diff_step=_STEP, max_nfev=_EVALUATIONS)
    whitening = _whitening(parts(best.x))
    starts = [best.x, min(starts, key=lambda scaled: float(np.sum(residuals(scaled) ** 2)))]
    fits = [
        least_squares(residuals, start, bounds=bounds, diff_step=_STEP, max_nfev=_EVALUATIONS)
        for start in starts
    ]
    best = min(fits, key=lambda result: float(result.cost))
    parameters = np.asarray(best.x) * scale
    lengths = [len(window.time_s) - AR_ORDER for window in windows]
    covariance = _covariance(np.asarray(best.jac) / scale, np.asarray(best.fun), windows, lengths)
    whitening = np.ones(1)
    left = float(np.sum(residuals(best.x) ** 2))
    moved = 0.0
    for window in windows:
        _, basis = model.predict(parameters, window)
        moved += float(np.sum(_project(basis, window.output) ** 2))
    flown = sum(window.duration_s for window in windows)
    degrees = max(0.5 * flown / CORRELATION_S - len(parameters), 3.0)
    return Fit(parameters, covariance, 1.0 - left / max(moved, 1e-12), degrees)


def _covariance(jacobian: Array, residual: Array, windows: list[Window], lengths: list[int]) -> Array:
    """Sandwich estimate; never below that for white residuals."""
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    samples, count = jacobian.shape
    meat = np.zeros((count, count))
    start = 0
    for window, length in zip(windows, lengths, strict=True):
        end = start + length
        score = jacobian[start:end] * residual[start:end, None]
        meat += score.T @ score
        lags = round(CORRELATION_S * (length - 1) / window.duration_s)
        for lag in range(1, min(lags, end - start - 1) + 1):
            product = score[lag:].T @ score[:-lag]
            meat += (1.0 - lag / (lags + 1.0)) * (product + product.T)
        start = end
    freedom = samples / max(samples - count - 3 * len(windows), 1)
    robust = freedom * bread @ meat @ bread
    white = freedom * float(residual @ residual) / samples * bread
    larger = np.sqrt(np.maximum(np.diag(robust), np.diag(white)) / np.maximum(np.diag(robust), 1e-30))
    return np.asarray(robust * np.outer(larger, larger))
