"""From a channel's numbers to a controller: the table of the named ones."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from kffa_offboard.control import Array, fuzzy, kalman, ladrc, observer, pid
from kffa_offboard.control import tracking_differentiator as td
from kffa_offboard.control.actuator import ActuatorParameters
from kffa_offboard.control.controllers import (
    NAMES,
    ControllerName,
    ControllerParameters,
    Limits,
)

PERIOD_TOLERANCE = 0.3
"""Of the Kalman filter (`kalman.KalmanParameters`). Telemetry has its times in whole milliseconds, so that
each step of a steady rate is a little another one; gains of their own would move estimates by a fiftieth of
their noise."""

REST_TOLERANCE = 0.02
"""Of the Kalman filter: a fifth of a second after a late sample gains are at rest again, with a jump of a
fiftieth at most."""

LATE_TOLERANCE = 2.0
"""Of the Kalman filter: two lost samples are no reason to leave rest. If a twentieth of all samples is late
by up to three periods, estimates have one to two hundredths more noise."""


@dataclass(frozen=True)
class DesignSettings:
    """The numbers that define a controller; every array ``(4,)`` or ``(4, N)`` in channel order.

    Attributes
    ----------
    b0, damping, stiffness : plant model (`observer.PlantModel`)
    omega_c, omega_o : controller and observer bandwidth, rad/s (eq 34-35)
    lower, upper, rate : limits of the command and of its change per second
    delay, lag : of the actuators, s (`actuator.ActuatorParameters`)
    prediction : how far ahead of the estimate the law looks, s; None does not
    trim : command at rest (hover thrust on the altitude channel); read by the PIDs
    acceleration : of the reference, units/s^2 (`tracking_differentiator`)
    acceleration_feedforward : share of the reference's acceleration that the law adds (0 is eq 25 as printed)
    use_differentiator : False gives the law the reference as it is
    error_scale, error_rate_scale, omega_c_range : fuzzy scaling (`fuzzy.FuzzyParameters`)
    measurement_variance, rate_variance, disturbance_intensity : Kalman filter (`kalman.KalmanParameters`)
    pid_gains : (3, 4) kp, ki, kd; None has those of `three_poles`
    pid_follows : see `pid.PidParameters.follow`
    hand_gains : (5, 4) kp, kd, l1, l2, l3 of the WB-LADRC; None takes what a person arrives at by hand: the
        same stiffness with damping ratio 0.5 and observer poles spread 1 : 2 : 3 up to omega_o
    cascade : True (4,) where `cascaded-pid` is P over PI; elsewhere it is P to a rate loop
    cascade_to_attitude : the channels that are no cascade pass their reference on (output = "attitude")
    cascade_gains : (3, 4) outer P, inner I, inner P; PX4's 1, 2, 4 on height and 6.5 on attitude
    """

    b0: Array
    omega_c: Array
    omega_o: Array
    lower: Array
    upper: Array
    damping: Array = field(default_factory=lambda: np.zeros(4))
    stiffness: Array = field(default_factory=lambda: np.zeros(4))
    rate: Array = field(default_factory=lambda: np.full(4, np.inf))
    delay: Array = field(default_factory=lambda: np.zeros(4))
    lag: Array = field(default_factory=lambda: np.zeros(4))
    prediction: Array | None = None
    trim: Array = field(default_factory=lambda: np.zeros(4))
    acceleration: Array = field(default_factory=lambda: np.full(4, 200.0))
    filter_time: float = 0.1
    acceleration_feedforward: float = 1.0
    use_differentiator: bool = True
    error_scale: Array = field(default_factory=lambda: np.ones(4))
    error_rate_scale: Array = field(default_factory=lambda: np.full(4, 10.0))
    omega_c_range: Array = field(default_factory=lambda: np.full(4, 4.0))
    rules: fuzzy.RuleBase = "even"
    measurement_variance: Array = field(default_factory=lambda: np.full(4, kalman.MEASUREMENT_VARIANCE))
    disturbance_intensity: Array = field(default_factory=lambda: np.full(4, 100.0))
    rate_variance: Array | None = None
    literal_filter: bool = False
    angular: tuple[bool, ...] = (True, True, True, False)
    pid_gains: Array | None = None
    pid_follows: bool = False
    hand_gains: Array | None = None
    cascade: tuple[bool, ...] = (False, False, False, True)
    cascade_gains: Array = field(
        default_factory=lambda: np.array([[6.5, 6.5, 2.8, 1.0], [0.0, 0.0, 0.0, 2.0], [0.0, 0.0, 0.0, 4.0]])
    )
    cascade_to_attitude: bool = False


def _check(name: str, settings: DesignSettings) -> None:
    """Refuse what cannot be a controller, in one line that names the number."""
    if name not in NAMES:
        raise ValueError(f"controller {name!r} is not known; choose one of {', '.join(NAMES)}")
    for key in ("b0", "omega_c", "omega_o", "acceleration", "error_scale", "error_rate_scale"):
        value = np.asarray(getattr(settings, key), dtype=float)
        if not np.all(np.isfinite(value)) or np.any(value <= 0.0):
            raise ValueError(f"{key} = {value.tolist()} must be positive and finite on every channel")
    for key in ("damping", "stiffness", "delay", "lag", "omega_c_range"):
        value = np.asarray(getattr(settings, key), dtype=float)
        if not np.all(np.isfinite(value)) or np.any(value < 0.0):
            raise ValueError(f"{key} = {value.tolist()} must be zero or more and finite on every channel")
    if np.any(settings.omega_c_range >= settings.omega_c):
        raise ValueError(
            f"omega_c_range = {np.asarray(settings.omega_c_range).tolist()} would let the fuzzy rules take "
            f"omega_c to zero; keep it below omega_c = {np.asarray(settings.omega_c).tolist()}"
        )
    if np.any(settings.lower >= settings.upper):
        raise ValueError(
            f"limits {np.asarray(settings.lower).tolist()} .. {np.asarray(settings.upper).tolist()} "
            "leave no room; lower must be below upper"
        )


def design(name: ControllerName, settings: DesignSettings) -> ControllerParameters:
    """Compose the controller `name` for the given numbers.

    Raises
    ------
    ValueError
        One line naming the number that makes no controller.
    """
    _check(name, settings)
    base = ControllerParameters(
        name=name,
        model=observer.PlantModel(settings.b0, settings.damping, settings.stiffness),
        actuator=ActuatorParameters(settings.delay, settings.lag),
        limits=Limits(settings.lower, settings.upper, settings.rate),
        angular=np.array(settings.angular),
        prediction=settings.prediction,
        differentiator=(
            td.TrackingDifferentiatorParameters(settings.acceleration, settings.filter_time)
            if settings.use_differentiator
            else None
        ),
    )
    if name == "pid":
        return replace(base, pid=_parallel_pid(settings))
    if name == "cascaded-pid":
        return replace(base, pid=_cascaded_pid(settings), differentiator=None)
    if name == "wb-ladrc":
        hand = _hand_gains(settings) if settings.hand_gains is None else settings.hand_gains
        return replace(
            base,
            observer=observer.ObserverParameters.from_gains(hand[2:5]),
            law=ladrc.LawParameters(
                settings.omega_c, settings.acceleration_feedforward, kp=hand[0], kd=hand[1]
            ),
        )
    adrc = replace(
        base,
        observer=observer.ObserverParameters.from_bandwidth(settings.omega_o),
        law=ladrc.LawParameters(settings.omega_c, settings.acceleration_feedforward),
    )
    if name == "ladrc":
        return adrc
    adaptive = replace(adrc, fuzzy=_fuzzy(settings))
    return adaptive if name == "fa-ladrc" else replace(adaptive, kalman=_kalman(settings))


def _fuzzy(settings: DesignSettings) -> fuzzy.FuzzyParameters:
    return fuzzy.FuzzyParameters(
        settings.error_scale, settings.error_rate_scale, settings.omega_c_range, settings.rules
    )


def _kalman(settings: DesignSettings) -> kalman.KalmanParameters:
    return kalman.KalmanParameters(
        settings.measurement_variance,
        settings.disturbance_intensity,
        settings.rate_variance,
        "literal" if settings.literal_filter else "extended",
        period_tolerance=PERIOD_TOLERANCE,
        rest_tolerance=REST_TOLERANCE,
        late_tolerance=LATE_TOLERANCE,
    )


def _hand_gains(settings: DesignSettings) -> Array:
    w, o = settings.omega_c, settings.omega_o
    a, b, c = o / 3.0, 2.0 * o / 3.0, o
    return np.array([w**2, w, a + b + c, a * b + b * c + a * c, a * b * c])


def three_poles(omega_c: Array) -> Array:
    """PID gains ``(3, 4)`` that put three poles of an ideal double integrator at omega_c / 2.

    At omega_c itself the delays that LADRC looks ahead over make a PID unstable.
    """
    w = omega_c / 2.0
    return np.array([3 * w**2, w**3, 3 * w])


def _parallel_pid(settings: DesignSettings) -> pid.PidParameters:
    kp, ki, kd = three_poles(settings.omega_c) if settings.pid_gains is None else settings.pid_gains
    never = np.zeros(len(settings.b0), dtype=bool)
    return pid.PidParameters(
        kp, ki, kd, settings.b0, settings.trim, never, never, never, follow=settings.pid_follows
    )


def _cascaded_pid(settings: DesignSettings) -> pid.PidParameters:
    outer, integral, inner = settings.cascade_gains
    cascade = np.array(settings.cascade)
    return pid.PidParameters(
        kp=outer,
        ki=integral,
        kd=inner,
        b0=settings.b0,
        trim=settings.trim,
        cascade=cascade,
        rate_command=~cascade & (not settings.cascade_to_attitude),
        pass_reference=~cascade & settings.cascade_to_attitude,
    )
