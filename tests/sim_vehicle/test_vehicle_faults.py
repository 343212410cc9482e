"""What breaks on the vehicle."""

import numpy as np
import pytest

from sim_vehicle import faults
from sim_vehicle.config import build
from sim_vehicle.config_faults import BatterySag, FaultsSection, Gust, ThrustLimit, WeakMotor

HALF = np.full(4, 0.5)


def test_a_weak_motor_gives_its_share_from_its_time_on():
    section = FaultsSection(weak_motor=(WeakMotor(start_s=2.0, motor=3, loss=0.3),))
    assert faults.motor_commands(section, 1.99, HALF).tolist() == [0.5] * 4
    assert faults.motor_commands(section, 2.0, HALF) == pytest.approx([0.5, 0.5, 0.35, 0.5])
    many = faults.motor_commands(section, 2.0, np.full((4, 7), 0.5))
    assert many[2] == pytest.approx(np.full(7, 0.35)) and many.shape == (4, 7)


def test_thrust_is_limited_for_its_time_and_a_battery_sags_to_its_lowest():
    section = FaultsSection(
        thrust_limit=(ThrustLimit(start_s=1.0, duration_s=1.0, share=0.2),),
        battery_sag=(BatterySag(start_s=5.0, loss_per_s=0.1, lowest=0.6),),
    )
    assert [float(faults.motor_commands(section, t, HALF)[0]) for t in (0.9, 1.5, 2.1, 6.0, 60.0)] == (
        pytest.approx([0.5, 0.2, 0.5, 0.45, 0.3])
    )


def test_a_gust_comes_and_goes():
    section = FaultsSection(gust=(Gust(start_s=1.0, duration_s=2.0, velocity_m_s=(12.0, 0.0, -1.0)),))
    assert faults.wind(section, 2.0).tolist() == [12.0, 0.0, -1.0]
    assert faults.wind(section, 3.0).tolist() == [0.0, 0.0, 0.0]


def test_faults_are_read_from_the_configuration():
    config = build(
        {"faults": {"weak_motor": [{"start_s": 3.0}], "gust": [{"start_s": 1.0, "duration_s": 1.0}]}}, "x"
    )
    assert config.faults.weak_motor[0].loss == 0.3 and config.faults.gust[0].velocity_m_s[0] == 12.0
