"""Which of the many voices on a MAVLink network is the vehicle."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.errors import UserError
from kffa_offboard.mavlink.commands import EncodingError
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.vehicle import Vehicle
from kffa_offboard.offboard.events import ModeKind, OwnHeartbeat, SetMode


@pytest.fixture
def vehicle(route):
    return Vehicle(route)


def test_the_first_heartbeat_tells_the_firmware(route, autopilot):
    for number, firmware in ((mavlink.MAV_AUTOPILOT_PX4, "px4"), (3, "ardupilot")):
        vehicle = Vehicle(route)
        (event,) = vehicle.decode(autopilot.over_the_wire(autopilot.heartbeat(number)))
        assert vehicle.firmware == event.firmware == firmware


def test_nothing_is_decoded_or_commanded_before_the_firmware_is_known(vehicle, autopilot):
    assert vehicle.decode(autopilot.over_the_wire(autopilot.attitude())) == []
    with pytest.raises(EncodingError, match="before the vehicle's first heartbeat"):
        vehicle.encode(SetMode(ModeKind.OFFBOARD), 0)
    assert len(vehicle.encode(OwnHeartbeat("standby"), 0)) == 1


@pytest.mark.parametrize(("system", "component"), [(2, 1), (255, 190), (1, 154), (1, 191)])
def test_other_systems_and_components_are_ignored(vehicle, autopilot, scripted, system, component):
    vehicle.decode(autopilot.over_the_wire(autopilot.heartbeat()))
    stranger = scripted(system, component)
    assert vehicle.decode(stranger.over_the_wire(stranger.attitude(roll=1.0))) == []
    beat = stranger.heartbeat(mavlink.MAV_AUTOPILOT_INVALID, kind=mavlink.MAV_TYPE_GCS)
    assert vehicle.decode(stranger.over_the_wire(beat)) == []
    assert len(vehicle.decode(autopilot.over_the_wire(autopilot.attitude()))) == 1


def test_a_ground_station_heard_first_is_not_taken_for_the_vehicle(vehicle, scripted):
    station = scripted(255, 190)
    beat = station.heartbeat(mavlink.MAV_AUTOPILOT_INVALID, kind=mavlink.MAV_TYPE_GCS)
    assert vehicle.decode(station.over_the_wire(beat)) == []
    assert vehicle.firmware is None


def test_another_target_can_be_configured(scripted):
    vehicle = Vehicle(Route(target_system=7, target_component=2))
    target = scripted(7, 2)
    assert len(vehicle.decode(target.over_the_wire(target.heartbeat()))) == 1


def test_an_unsupported_autopilot_is_named_in_one_line(vehicle, autopilot):
    beat = autopilot.heartbeat(mavlink.MAV_AUTOPILOT_GENERIC)
    with pytest.raises(
        UserError, match=r"system 1 component 1 runs autopilot GENERIC.*target_system"
    ) as info:
        vehicle.decode(autopilot.over_the_wire(beat))
    assert "\n" not in str(info.value)


def test_an_aeroplane_is_refused_because_its_mode_numbers_mean_something_else(vehicle, autopilot):
    beat = autopilot.heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA, kind=mavlink.MAV_TYPE_FIXED_WING)
    with pytest.raises(UserError, match=r"FIXED_WING.*multirotors only"):
        vehicle.decode(autopilot.over_the_wire(beat))


def test_a_second_vehicle_with_the_same_ids_does_not_change_what_we_fly(vehicle, autopilot):
    vehicle.decode(autopilot.over_the_wire(autopilot.heartbeat(mavlink.MAV_AUTOPILOT_PX4)))
    other = autopilot.over_the_wire(autopilot.heartbeat(mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA))
    assert vehicle.decode(other) == []
    assert vehicle.firmware == "px4"
