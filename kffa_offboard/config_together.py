"""Numbers of a configuration that are possible one by one and not together.

Each of these combinations was flown in the simulator and went wrong in the air, or never began.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import sqrt

from kffa_offboard.config_control import AttitudeAxisTable, ChannelTable, ControlTable
from kffa_offboard.config_payload import PayloadTable
from kffa_offboard.config_position import damping_controller
from kffa_offboard.config_scenario import TakeoffTable
from kffa_offboard.config_tables import ConfigFile
from kffa_offboard.control.pendulum import damped_ropes
from kffa_offboard.control.position import answer_of

MOST_DELAY, MOST_PREDICTION = 1.5, 2.0
"""Of 1 / omega_c, s: with a longer delay, or a look further ahead, the loop oscillates."""

SLOWEST_HOLD = 0.1
"""Of natural_frequency_rad_s: with a lower omega_c neither the autopilot's hold nor the daemon's is left."""

CASCADE_BANDWIDTH = 2.5
"""Of the height under controller "cascaded-pid", rad/s."""

MOST_RING_DELAY = 1.5
"""Of 1 / omega_c of the position ring, s: delay and lag of the attitude loop below it."""


EQUAL_LOAD = 1.0
"""Of the vehicle's mass: the load on a rope where the heaviest is not told."""


SOFTEST_BOUNCE, STIFFEST_BOUNCE = 1.2, 8.0
"""Of omega_c of the altitude: load and vehicle must not bounce between these on a rope that stretches.
With omega_c = 3 to 8 thrust shook from end to end on ropes of 17 to 39 rad/s."""


def check_together(tables: ConfigFile) -> None:
    """Raise ValueError, one line with keys, values and remedy, for the first combination that cannot fly."""
    problem = (
        _slow_loop(tables.control)
        or _slow_thrust(tables)
        or _heavy_load(tables)
        or _short_ramp(tables)
        or _rare_telemetry(tables)
        or _late_attitude(tables)
        or _swinging_load(tables)
        or _bouncing_load(tables)
    )
    if problem is not None:
        raise ValueError(problem)


def _flown(control: ControlTable) -> Iterator[tuple[str, ChannelTable]]:
    """The channels that fly, by their tables' names."""
    axes = control.rates if control.output == "rates" else control.attitude
    for name in ("roll", "pitch", "yaw"):
        yield f"control.{control.output}.{name}", getattr(axes, name)
    yield "control.altitude", control.altitude


def _slow_loop(control: ControlTable) -> str | None:
    if control.controller in ("pid", "cascaded-pid"):  # omega_c is not theirs, and they do not look ahead
        return None
    for name, channel in _flown(control):
        omega_c = channel.omega_c
        for key, most in (("delay_s", MOST_DELAY), ("prediction_s", MOST_PREDICTION)):
            told = getattr(channel, key)
            if told is not None and told * omega_c > most:
                return (
                    f"{name}: {key} = {told:g} s is more than omega_c = {omega_c:g} rad/s bears; "
                    f"keep it within {most:g} / omega_c = {most / omega_c:.3g} s, or lower omega_c"
                )
        if not isinstance(channel, AttitudeAxisTable):
            continue
        least = SLOWEST_HOLD * channel.natural_frequency_rad_s
        if omega_c < least:
            return (
                f"{name}: omega_c = {omega_c:g} rad/s takes the autopilot's own hold away and gives too "
                f"little for it; give at least {least:.3g} rad/s, best about natural_frequency_rad_s = "
                f"{channel.natural_frequency_rad_s:g}"
            )
    return None


def _slow_thrust(tables: ConfigFile) -> str | None:
    """A limit on the change of thrust is one more lag, and the larger the error, the longer."""
    altitude, rate = tables.control.altitude, tables.limits.thrust_rate_max_per_s
    bandwidth = CASCADE_BANDWIDTH if tables.control.controller == "cascaded-pid" else altitude.omega_c
    needed = bandwidth * altitude.hover_thrust
    if rate >= needed:
        return None
    return (
        f"limits.thrust_rate_max_per_s = {rate:g}: thrust would follow too slowly; give at least "
        f"{needed:.3g}, hover_thrust = {altitude.hover_thrust:g} times {bandwidth:g} rad/s of bandwidth"
    )


def _heavy_load(tables: ConfigFile) -> str | None:
    payload, limits = tables.payload, tables.limits
    if not payload.enabled or payload.vehicle_mass_kg is None or payload.max_load_kg is None:
        return None
    needed = tables.control.altitude.hover_thrust * (1.0 + payload.max_load_kg / payload.vehicle_mass_kg)
    if needed < limits.thrust_max:
        return None
    return (
        f"payload.max_load_kg = {payload.max_load_kg:g}: takes {needed:.3g} of full thrust to carry, "
        f"limits.thrust_max = {limits.thrust_max:g}; lower the one or raise the other"
    )


def _short_ramp(tables: ConfigFile) -> str | None:
    flight, hover = tables.flight, tables.control.altitude.hover_thrust
    reached = flight.ramp_rate_per_s * flight.liftoff_timeout_s
    if reached > hover or not any(isinstance(segment, TakeoffTable) for segment in tables.scenario.segment):
        return None
    return (
        f"flight.ramp_rate_per_s = {flight.ramp_rate_per_s:g}: reaches {reached:.3g} of full thrust in "
        f"liftoff_timeout_s = {flight.liftoff_timeout_s:g}, and hover_thrust = {hover:g}; raise one of them"
    )


def _rare_telemetry(tables: ConfigFile) -> str | None:
    """Not even what is asked for is enough for taking control. `admission` judges what omega_o needs."""
    asked = tables.telemetry
    for name, rate, minimum in (
        ("attitude", asked.attitude_hz, asked.minimum_attitude_hz),
        ("position", asked.position_hz, asked.minimum_position_hz),
    ):
        needed = asked.rate_fraction * minimum
        if rate <= needed:
            return (
                f"telemetry.{name}_hz = {rate:g}: is not above rate_fraction times minimum_{name}_hz = "
                f"{needed:g}, so that control would never be taken; raise the one or lower the other"
            )
    return None


def _late_attitude(tables: ConfigFile) -> str | None:
    """The ring looks ahead over delay and lag of the attitude loop, whose reference filter is part of it."""
    ring, told = tables.position, tables.position.delay_s + tables.position.lag_s
    if not ring.enabled:
        return None
    if tables.control.reference_filter_s > told:
        return (
            f"control.reference_filter_s = {tables.control.reference_filter_s:g}: makes roll and pitch later "
            f"than position.delay_s + lag_s = {told:g}; lower it, or raise these and lower position.omega_c"
        )
    if ring.omega_c * told > MOST_RING_DELAY:
        return (
            f"position.omega_c = {ring.omega_c:g}: is too much for delay_s + lag_s = {told:g}; give "
            f"{MOST_RING_DELAY / told:.3g} rad/s at the most, usually a third of it"
        )
    return None


def _swinging_load(tables: ConfigFile) -> str | None:
    """Outside of some lengths of the rope the ring drives the load instead of damping it."""
    ring, payload, control = tables.position, tables.payload, tables.control
    numbers, length = ring.numbers(control), payload.rope_length_m
    answer = answer_of(damping_controller(control), numbers)
    if not ring.enabled or length == 0.0 or answer is None:
        return None
    damped = damped_ropes(answer, numbers.delay, numbers.lag, _heaviest(payload), numbers.gravity)
    if damped is not None and damped[0] <= length <= damped[1]:
        return None
    told = f"position.omega_c = {ring.omega_c:g} and delay_s + lag_s = {ring.delay_s + ring.lag_s:g}"
    if damped is None:
        return f"payload.rope_length_m = {length:g}: with {told} the ring damps no swing; lower omega_c"
    remedy = "lower omega_c" if length > damped[1] else "take a longer rope, or hold the load rigidly"
    return (
        f"payload.rope_length_m = {length:g}: the position ring would drive the swing; with {told} it damps "
        f"that of {damped[0]:.2g} to {damped[1]:.2g} m; {remedy}"
    )


def _heaviest(payload: PayloadTable) -> float:
    """The heaviest load, by the vehicle's mass."""
    if payload.max_load_kg is None or payload.vehicle_mass_kg is None:
        return EQUAL_LOAD
    return payload.max_load_kg / payload.vehicle_mass_kg


def _bouncing_load(tables: ConfigFile) -> str | None:
    """A height loop shakes where load and vehicle bounce on their rope about as quickly as it answers."""
    payload, control = tables.payload, tables.control
    stiffness, mass = payload.rope_stiffness_n_m, payload.vehicle_mass_kg
    if stiffness is None or mass is None or control.controller in ("pid", "cascaded-pid"):
        return None
    omega_c = control.altitude.omega_c
    together = (1.0 + 1.0 / _heaviest(payload)) / mass
    bounce = sqrt(stiffness * together)
    if not SOFTEST_BOUNCE * omega_c < bounce < STIFFEST_BOUNCE * omega_c:
        return None
    stiff, slow = (STIFFEST_BOUNCE * omega_c) ** 2 / together, bounce / STIFFEST_BOUNCE
    return (
        f"payload.rope_stiffness_n_m = {stiffness:g}: the heaviest load bounces on it with {bounce:.3g} "
        f"rad/s; control.altitude.omega_c = {omega_c:g} would drive that; take a rope of {stiff:.0f} N/m at "
        f"least, or lower omega_c to {slow:.2g}"
    )
