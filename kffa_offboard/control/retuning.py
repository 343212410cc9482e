"""Other numbers for a controller in flight, without a bump: its state goes on.

Bandwidths, weights and limits need nothing: the estimates stay, and the next command differs by what the
new gains make of the present error. A plant model with other numbers explains the same acceleration with
another disturbance; without that step the observer would have to find it, and the vehicle would feel it.

What follows from parameters is remembered for these very objects (`memory.py`); `as_before` keeps the objects
of all that stays the same, so that the next step need not work it out again.
"""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import TypeVar

import numpy as np
from msgspec import structs

from kffa_offboard.control import Array, column, kalman
from kffa_offboard.control.controllers import ControllerParameters, ControllerState

Value = TypeVar("Value")


def as_before(before: Value, after: Value) -> Value:
    """`after`, but with the objects of `before` for every part that is equal; for frozen parameters."""
    if type(before) is not type(after):
        return after
    if isinstance(before, np.ndarray) and isinstance(after, np.ndarray):
        same = before.shape == after.shape and before.tobytes() == after.tobytes()
    elif is_dataclass(before) and not isinstance(before, type):
        names = [item.name for item in fields(before)]
        kept = {name: as_before(getattr(before, name), getattr(after, name)) for name in names}
        same = all(part is getattr(before, name) for name, part in kept.items())
        if not same and any(part is not getattr(after, name) for name, part in kept.items()):
            return replace(after, **kept)  # type: ignore[type-var]
    else:
        same = bool(before == after)
    return before if same else after


def retuned(
    before: ControllerParameters, after: ControllerParameters, state: ControllerState
) -> ControllerState:
    """The state with which `after` goes on where `before` stands.

    The commands under way stay: with a longer delay the oldest that is kept counts as the one before it,
    with a shorter one the next step forgets those that are too old.

    Raises
    ------
    ValueError
        If the two are not built of the same blocks.
    """
    if before.name != after.name or (after.kalman is None) != (state.kalman is None):
        raise ValueError(f"controller {after.name} cannot go on from the state of {before.name}")
    if before.kalman is not None and after.kalman is not None and before.kalman.states != after.kalman.states:
        raise ValueError("the Kalman filter's model cannot be changed in flight")
    change = _explained(before, state) - _explained(after, state)
    observed = structs.replace(state.observer, disturbance=state.observer.disturbance + change)
    filtered = state.kalman
    if after.kalman is not None and filtered is not None and after.kalman.states == 3:
        filtered = kalman.with_disturbance_step(after.kalman, filtered, change)
    state = structs.replace(state, observer=observed, kalman=filtered)
    return _rebalanced(before, after, state)


def _explained(parameters: ControllerParameters, state: ControllerState) -> Array:
    """Acceleration ``(4[, N])`` that the plant model explains without a disturbance."""
    model, estimate, rate = parameters.model, state.observer.estimate, state.observer.rate
    acting = state.actuator.lagged
    explained = column(model.b0, acting) * acting
    explained = explained - column(model.damping, acting) * rate
    return np.asarray(explained - column(model.stiffness, acting) * estimate)


def _rebalanced(
    before: ControllerParameters, after: ControllerParameters, state: ControllerState
) -> ControllerState:
    """Let the integral of a PID hold the balance with another gain of the plant and another trim."""
    if before.pid is None or after.pid is None:
        return state
    old, new, integral = before.pid, after.pid, state.pid.integral
    held = integral / column(old.b0, integral) + column(old.trim, integral) - column(new.trim, integral)
    balanced = np.where(column(new.ki, integral) > 0.0, held * column(new.b0, integral), integral)
    return structs.replace(state, pid=structs.replace(state.pid, integral=balanced))
