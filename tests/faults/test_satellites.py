"""The satellites are gone and the estimator reckons on: the ring ends control, and level flight goes on."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import bundled, load
from kffa_offboard.offboard.service import State
from sim_vehicle.flight_modes import CopterMode, Px4Mode

AT = 3.2  # s; the daemon is engaged at 2.42
LOST = {"faults": {"satellite_loss": [{"start_s": AT, "drift_m_s2": [0.1, 0.05]}]}}
RECKONING_S = {"px4": 4.0, "ardupilot": 7.0}


def ring(personality):
    return {"position": load(bundled(f"demo-{personality}-position.toml")).service.position}


def test_the_ring_ends_control_a_second_after_px4_calls_its_position_invalid(fault_flight):
    """PX4's own failsafe does not act in OFFBOARD by rates: the ring flew after a position that drifted."""
    flight = fault_flight("px4", vehicle_changes=LOST, changes=ring("px4")).prepare().until(AT)
    flight.go_on(lambda: flight.over(12.0))
    assert "failsafe: autopilot calls its position invalid" in flight.texts
    assert flight.violations == []
    assert flight.released_s == pytest.approx(AT + RECKONING_S["px4"] + 1.2, abs=0.3)
    x, y, _ = flight.vehicle.state.position.tolist()
    assert abs(x) < 1.8 and abs(y) < 1.0, "what it has reckoned wrong by then"
    assert max(flight.tilts) < 0.1


def test_without_the_ring_height_and_attitude_are_kept(fault_flight):
    flight = fault_flight("px4", vehicle_changes=LOST, seconds=12.0).fly()
    assert flight.released_s is None and flight.violations == []
    assert "position invalid: the fence is not watched" in flight.texts
    assert max(abs(height - 5.0) for height in flight.heights) < 0.05 and max(flight.tilts) < 0.05


def test_arducopter_lands_by_itself_and_the_daemon_lets_it(fault_flight):
    flight = fault_flight("ardupilot", vehicle_changes=LOST, changes=ring("ardupilot"), seconds=16.0).fly()
    assert flight.service.state is not State.ENGAGED and flight.violations == []
    assert "control given up: mode LAND" in flight.texts
    assert flight.vehicle.firmware.mode is CopterMode.LAND


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_the_simulated_autopilots_say_so_and_come_down_level_in_their_own_modes(fault_flight, personality):
    """Flags of the real ones, measured; they go on sending a position."""
    flight = fault_flight(personality, vehicle_changes=LOST).prepare()
    vehicle = flight.vehicle
    number = {
        "px4": mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS,
        "ardupilot": mavlink.MAVLINK_MSG_ID_EKF_STATUS_REPORT,
    }[personality]
    horizontal = (
        mavlink.ESTIMATOR_VELOCITY_HORIZ | mavlink.ESTIMATOR_POS_HORIZ_REL | mavlink.ESTIMATOR_POS_HORIZ_ABS
    )
    vehicle.advance(round((AT + RECKONING_S[personality] - 0.1) * 1e6))
    assert vehicle.server.build(number).flags & horizontal == horizontal
    vehicle.advance(round((AT + RECKONING_S[personality] + 0.3) * 1e6))
    assert vehicle.firmware.mode is not CopterMode.LAND, "its failsafe takes another second"
    flags = vehicle.server.build(number).flags
    assert not flags & horizontal
    assert flags & mavlink.ESTIMATOR_ATTITUDE and flags & mavlink.ESTIMATOR_VELOCITY_VERT
    assert vehicle.server.build(mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED) is not None
    vehicle.advance(vehicle.time_us + 1_000_000)
    assert vehicle.firmware.mode in (Px4Mode.LAND, CopterMode.LAND)
    assert abs(vehicle.state.euler[:2]).max() < 0.02
