"""ArduCopter and PX4 are told of the vehicle by the same receiver and the same barometer."""

import math
from pathlib import Path

import pytest

from sim_vehicle.backends import px4_sensors
from sim_vehicle.backends.px4_hil import FIX_PERIOD_US, SLOW_PERIOD_US

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
READING_HZ = 10.0
"""ArduCopter's scheduler reads its barometer at this rate."""

TRANSPORT_MS = 20.0
"""From the simulated receiver's message to its reading by ArduCopter, measured by calm innovations."""


def arducopter() -> dict[str, float]:
    lines = (CONFIGS / "ardupilot-json.parm").read_text().splitlines()
    pairs = [line.split() for line in lines if line.strip() and not line.startswith("#")]
    return {name: float(value) for name, value in pairs}


def px4() -> dict[str, float]:
    """What our start script sets; a mere default ("set-default") is open to PX4's own scripts that follow."""
    lines = (CONFIGS / "px4-hil" / "px4-rc.params").read_text().splitlines()
    pairs = [line.split()[2:] for line in lines if line.startswith("param set ")]
    return {name: float(value) for name, value in pairs}


def test_both_receivers_report_as_often_and_as_late():
    delay_ms = px4_sensors.Px4SensorNoise().fix_delay_us / 1e3
    assert arducopter()["SIM_GPS1_HZ"] == 1e6 / FIX_PERIOD_US
    assert arducopter()["SIM_GPS1_LAG_MS"] == delay_ms


def test_both_firmwares_are_told_how_late_a_fix_is():
    delay_ms = px4_sensors.Px4SensorNoise().fix_delay_us / 1e3
    assert px4()["EKF2_GPS_DELAY"] == delay_ms  # px4-rc.simulator has a default of 10, later
    assert arducopter()["GPS1_DELAY_MS"] == delay_ms + TRANSPORT_MS


def test_arducopters_receiver_takes_a_fix_from_its_past_and_does_not_draw_a_line_between_two():
    period_ms = 1e3 / arducopter()["SIM_GPS1_HZ"]
    assert arducopter()["SIM_GPS1_LAG_MS"] % period_ms == 0.0
    assert arducopter()["GPS1_RATE_MS"] == period_ms


def test_both_barometers_have_the_same_noise_for_each_second():
    pressure = px4_sensors.standard_pressure(488.0)
    metres = px4_sensors.pressure_altitude(
        pressure - px4_sensors.Px4SensorNoise().pressure
    ) - px4_sensors.pressure_altitude(pressure)
    each_second = metres**2 * SLOW_PERIOD_US * 1e-6
    evenly_spread = arducopter()["SIM_BARO_RND"] / math.sqrt(3.0)
    assert evenly_spread**2 / READING_HZ == pytest.approx(each_second, rel=0.1)
