"""The load: centre of mass, arm and inertia by hand; the limit; the schedule."""

import numpy as np
import pytest

from sim_vehicle import payload
from sim_vehicle.payload import PayloadSchedule, VehicleBody, mass_properties

BODY = VehicleBody(10.0, (0.2906, 0.2906, 0.2906), 0.44)


def test_without_load_the_vehicle_is_itself() -> None:
    for profile in ("paper", "airframe"):
        properties = mass_properties(BODY, 0.0, profile=profile)
        assert properties.mass == 10.0
        assert properties.arm_length == pytest.approx(0.44)
        np.testing.assert_array_equal(properties.inertia, [0.2906, 0.2906, 0.2906])
        np.testing.assert_array_equal(properties.center_of_mass, 0.0)


def test_five_kilograms_lower_the_centre_of_mass_by_ten_centimetres() -> None:
    """Eq 13: z_a = m z_2 / (M + m) = 5 * -0.3 / 15."""
    np.testing.assert_allclose(mass_properties(BODY, 5.0).center_of_mass, [0.0, 0.0, -0.1])
    assert mass_properties(BODY, 5.0).mass == 15.0


def test_in_the_paper_profile_the_arm_grows_and_the_inertia_stays() -> None:
    """Last line of eq 15: l = sqrt(0.44^2 + 0.1^2) = 0.4512205669..."""
    properties = mass_properties(BODY, 5.0, profile="paper")
    assert properties.arm_length == pytest.approx(0.45122056690713)
    np.testing.assert_array_equal(properties.inertia, [0.2906, 0.2906, 0.2906])


def test_in_the_airframe_profile_both_bodies_count_about_the_common_centre() -> None:
    """The vehicle is 0.1 m above it, the load 0.2 m below: 10 * 0.01 + 5 * 0.04 = 0.3 kg m^2."""
    properties = mass_properties(BODY, 5.0)
    np.testing.assert_allclose(properties.inertia, [0.5906, 0.5906, 0.2906])
    np.testing.assert_array_equal(properties.products_of_inertia, 0.0)
    assert properties.arm_length == 0.44


def test_an_off_centre_load_gives_products_of_inertia() -> None:
    """Offset (0.3, 0, -0.3): vehicle at (-0.1, 0, 0.1), load at (0.2, 0, -0.2) of the common centre."""
    properties = mass_properties(BODY, 5.0, (0.3, 0.0, -0.3))
    np.testing.assert_allclose(properties.center_of_mass, [0.1, 0.0, -0.1])
    np.testing.assert_allclose(properties.inertia, [0.5906, 0.8906, 0.5906])
    np.testing.assert_allclose(properties.products_of_inertia, [0.0, 0.3, 0.0], atol=1e-15)


def test_a_box_has_inertia_of_its_own() -> None:
    """m / 12 (b^2 + c^2) for edges 0.3, 0.2, 0.1 m and 6 kg."""
    box = mass_properties(BODY, 6.0, load_size=(0.3, 0.2, 0.1)).inertia
    point = mass_properties(BODY, 6.0).inertia
    np.testing.assert_allclose(box - point, [0.025, 0.05, 0.065])


def test_a_batch_of_loads_equals_the_loads_one_by_one() -> None:
    loads = np.array([0.0, 2.5, 5.0, 6.73])
    for profile in ("paper", "airframe"):
        together = mass_properties(BODY, loads, (0.1, 0.2, -0.3), (0.1, 0.1, 0.1), profile)
        for index, load in enumerate(loads):
            alone = mass_properties(BODY, float(load), (0.1, 0.2, -0.3), (0.1, 0.1, 0.1), profile)
            inertia = np.broadcast_to(together.inertia.T, (4, 3))[index]
            np.testing.assert_allclose(inertia, alone.inertia, atol=1e-15)
            np.testing.assert_allclose(together.center_of_mass[:, index], alone.center_of_mass, atol=1e-15)
            arm = np.broadcast_to(together.arm_length, 4)[index]
            assert arm == pytest.approx(alone.arm_length, abs=1e-15)


# --------------------------------------------------------------------------------- the limit


def test_the_heaviest_load_of_table_1_is_carried() -> None:
    assert mass_properties(BODY, 6.73).mass == pytest.approx(16.73)


def test_a_heavier_load_is_refused_and_the_limit_named() -> None:
    with pytest.raises(
        ValueError, match=r"^load of 7 kg is above the limit of 6\.73 kg; choose a lighter load$"
    ):
        mass_properties(BODY, 7.0)


def test_one_load_too_heavy_in_a_batch_is_refused() -> None:
    with pytest.raises(ValueError, match=r"load of 6\.74 kg is above the limit of 6\.73 kg"):
        mass_properties(BODY, np.array([1.0, 6.74, 2.0]))


@pytest.mark.parametrize("mass", [-0.1, np.array([1.0, -0.1])])
def test_a_negative_load_is_refused(mass: float | np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"load of -0\.1 kg is below zero; give a mass of 0 to 6\.73 kg"):
        payload.check_load_mass(mass)


@pytest.mark.parametrize("mass", [float("nan"), float("inf"), np.array([1.0, np.nan])])
def test_a_load_that_is_no_number_is_refused(mass: float | np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"load of (nan|inf) kg is not a number"):
        payload.check_load_mass(mass)


# ------------------------------------------------------------------------------- the schedule


def test_a_load_hangs_from_its_pick_up_to_its_drop() -> None:
    schedule = PayloadSchedule(((12.0, 5.0), (20.0, 0.0)))
    times = [0.0, 11.999, 12.0, 19.999, 20.0, 100.0]
    assert [schedule.mass_at(time_s) for time_s in times] == [0.0, 0.0, 5.0, 5.0, 0.0, 0.0]


def test_an_empty_schedule_means_no_load() -> None:
    assert PayloadSchedule().mass_at(3.0) == 0.0


def test_a_schedule_out_of_order_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"load change at 12 s comes after the one at 20 s; list the changes"
    ):
        PayloadSchedule(((20.0, 0.0), (12.0, 5.0)))


def test_a_schedule_with_too_heavy_a_load_is_refused() -> None:
    with pytest.raises(ValueError, match="load of 7 kg is above the limit"):
        PayloadSchedule(((12.0, 7.0),))


def test_a_schedule_with_a_time_that_is_no_number_is_refused() -> None:
    with pytest.raises(ValueError, match="load change at nan s is not a time"):
        PayloadSchedule(((float("nan"), 5.0),))
