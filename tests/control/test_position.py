"""The position ring: acceleration to angles and back, a step, wind, limited tilt, batch."""

from dataclasses import replace

import numpy as np
import pytest

from kffa_offboard.control import controllers, position
from kffa_offboard.control.position import PositionDesign, PositionInput

G = position.STANDARD_GRAVITY
NUMBERS = PositionDesign(tilt_max=np.radians(20.0))


def thrust_direction(roll, pitch, yaw):
    """Third column of Rz(yaw) Ry(pitch) Rx(roll), multiplied out."""
    rz = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    ry = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    rx = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    return (rz @ ry @ rx)[:, 2]


@pytest.mark.parametrize("yaw", [0.0, 0.7, 2.0, -3.0])
@pytest.mark.parametrize("wanted", [(1.0, 0.0), (0.0, 2.0), (-3.0, 1.5)])
def test_the_angles_point_the_thrust_so_that_the_vehicle_accelerates_as_wanted(yaw, wanted):
    roll, pitch = position.attitude_of(G, np.array(wanted), yaw)
    direction = thrust_direction(roll, pitch, yaw)
    assert G * direction[:2] / direction[2] == pytest.approx(wanted, abs=1e-12)


def test_the_angles_have_the_sign_of_the_papers_axes():
    roll, pitch = position.attitude_of(G, np.array([1.0, 0.0]), 0.0)
    assert roll == 0.0 and pitch > 0.0  # nose down, to the north
    roll, pitch = position.attitude_of(G, np.array([0.0, 1.0]), 0.0)
    assert roll < 0.0 and abs(pitch) < 1e-12  # left side down, to the west


def test_what_the_attitude_gives_is_the_inverse():
    attitude = np.array([0.2, -0.3, 1.1])
    roll, pitch = position.attitude_of(G, position.acceleration_of(G, attitude), attitude[2])
    assert (roll, pitch) == pytest.approx(attitude[:2])


def test_an_attitude_on_its_side_gives_finite_numbers():
    assert np.all(np.isfinite(position.acceleration_of(G, np.array([np.pi / 2, 0.3, 0.0]))))


def fly(numbers, reference, duration, *, name="kffa-ladrc", wind=(0.0, 0.0), yaw=0.0, measured=True, dt=0.01):
    """A point mass whose roll and pitch follow the ring with 0.1 s delay and 0.12 s lag.

    Returns positions, tilts and disturbance estimates, first axis time.
    """
    ring = position.design_ring(name, numbers)
    reference = np.asarray(reference, dtype=float)
    place, velocity = np.zeros_like(reference), np.zeros_like(reference)
    wind = np.reshape(np.asarray(wind), (2,) + (1,) * (reference.ndim - 1))
    state = position.initial_state(ring, place, np.zeros_like(place))
    pipe, angles = [np.zeros_like(place)] * round(0.1 / dt), np.zeros_like(place)
    headings = np.broadcast_to(yaw, place.shape[1:])
    positions, tilts, estimates = [], [], []
    for _ in range(round(duration / dt)):
        acceleration = position.acceleration_of(G, np.stack([*angles, headings]))
        inputs = PositionInput(
            reference,
            place,
            np.ones_like(place, dtype=bool),
            headings,
            velocity,
            acceleration if measured else None,
        )
        state, output = position.step(ring, state, inputs, dt)
        pipe = [*pipe[1:], output.attitude]
        angles = angles + (1.0 - np.exp(-dt / 0.12)) * (pipe[0] - angles)
        total = position.acceleration_of(G, np.stack([*angles, headings])) + wind
        place = place + velocity * dt + 0.5 * total * dt**2
        velocity = velocity + total * dt
        positions.append(place)
        tilts.append(output.attitude)
        estimates.append(output.ring.disturbance)
    return np.array(positions), np.array(tilts), np.array(estimates)


@pytest.mark.parametrize("measured", [True, False])
def test_a_step_of_five_metres_is_flown_without_overshoot(measured):
    positions, _, _ = fly(NUMBERS, [5.0, 0.0], 7.0, yaw=0.8, measured=measured)
    assert positions[:, 0].max() <= 5.0 * 1.02
    assert np.abs(positions[:, 1]).max() <= 0.05
    assert abs(positions[-1, 0] - 5.0) <= 0.01
    assert positions[500, 0] >= 0.95 * 5.0


def test_a_wind_that_begins_is_found_and_held_against():
    positions, tilts, estimates = fly(NUMBERS, [0.0, 0.0], 12.0, wind=(0.3, -0.2))
    assert np.hypot(*positions.T).max() <= 0.25
    assert np.hypot(*positions[-1]) <= 0.01
    assert estimates[-1] == pytest.approx([0.3, -0.2], abs=0.01)
    assert tilts[-1] == pytest.approx(position.attitude_of(G, np.array([-0.3, 0.2]), 0.0), abs=0.002)


def test_tilt_never_exceeds_its_limit_and_the_direction_stays():
    _, tilts, _ = fly(NUMBERS, [40.0, 30.0], 3.0)
    cosines = np.cos(tilts[:, 0]) * np.cos(tilts[:, 1])
    assert np.degrees(np.arccos(cosines)).max() == pytest.approx(20.0, abs=1e-6)
    ring = position.design_ring("ladrc", NUMBERS)
    limited = position.limit_tilt(ring, np.array([8.0, 6.0]))
    assert limited == pytest.approx(np.array([0.8, 0.6]) * G * np.tan(np.radians(20.0)))


def test_a_limit_that_lasts_winds_nothing_up():
    weak = replace(NUMBERS, tilt_max=np.radians(4.0))
    positions, _, estimates = fly(weak, [5.0, 0.0], 20.0, measured=False, dt=0.02)
    assert positions[:, 0].max() <= 5.0 * 1.05
    assert np.abs(estimates).max() <= 0.05


def test_the_measured_attitude_is_believed_not_the_command():
    ring = position.design_ring("kffa-ladrc", NUMBERS)
    state = position.initial_state(ring, np.zeros(2), np.zeros(2))
    for _ in range(
        300
    ):  # the attitude loop does not follow: level, at rest, while the ring would go elsewhere
        inputs = PositionInput(
            np.array([3.0, 0.0]), np.zeros(2), np.ones(2, bool), 0.0, np.zeros(2), np.zeros(2)
        )
        state, output = position.step(ring, state, inputs, 0.01)
    assert output.ring.command[0] > 2.0
    assert output.ring.disturbance == pytest.approx([0.0, 0.0], abs=0.5)


@pytest.mark.parametrize("name", controllers.NAMES)
def test_every_controller_makes_a_ring_that_arrives(name):
    positions, _, _ = fly(NUMBERS, [1.0, -1.0], 25.0, name=name, dt=0.02)
    assert positions[-1] == pytest.approx([1.0, -1.0], abs=0.05)


def test_a_batch_flies_as_its_single_flights():
    references = np.array([[5.0, 0.0, -2.0], [0.0, 3.0, 1.0]])
    yaw = np.array([0.0, 1.0, -2.0])
    together, _, _ = fly(NUMBERS, references, 3.0, yaw=yaw)
    for k in range(3):
        alone, _, _ = fly(NUMBERS, references[:, k], 3.0, yaw=yaw[k])
        np.testing.assert_allclose(together[:, :, k], alone, atol=1e-9)


def test_a_tilt_limit_that_is_no_angle_is_refused():
    with pytest.raises(ValueError, match="tilt_max = 2 rad"):
        position.design_ring("ladrc", replace(NUMBERS, tilt_max=2.0))
