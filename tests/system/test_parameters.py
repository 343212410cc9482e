"""The daemon and the parameters of a simulated vehicle: refused, set on request, put back at the end."""

from dataclasses import replace

import pytest

from kffa_offboard.mavlink.parameter_file import ParameterFile
from kffa_offboard.offboard.events import AttitudeTarget, SetArmed, SetMode
from kffa_offboard.offboard.segments import Hold, Land, Takeoff

STOCK = {"GUID_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0, "ATC_ANGLE_BOOST": 1.0}
SET = {"GUID_OPTIONS": 8.0, "GUID_TIMEOUT": 0.5, "ATC_ANGLE_BOOST": 0.0}


@pytest.fixture
def record(tmp_path):
    return ParameterFile(tmp_path / "changed.json")


def short(flight):
    """Up, down, done: a few seconds of simulated time."""
    service = replace(flight.daemon.service, scenario=(Takeoff(1.0, 1.0), Hold(0.5), Land(0.7)))
    flight.daemon = replace(flight.daemon, service=service)
    return flight


def stock(flight):
    """The simulated ArduCopter as it comes, not as the demonstration sets it up."""
    for name, value in STOCK.items():
        flight.vehicle.firmware.parameters.set(name, value)
    return short(flight)


def values(flight):
    return {name: flight.vehicle.firmware.parameters[name] for name in STOCK}


def test_a_stock_arducopter_is_not_engaged_and_the_reason_has_the_remedy(lock_step_flight, record):
    flight = stock(lock_step_flight("ardupilot"))
    flight.check_parameters(record)
    result = flight.fly()
    assert not result.finished.successful
    assert result.finished.reason == (
        "not engaged: GUID_OPTIONS bit 3 is off: thrust would be read as climb rate; set GUID_OPTIONS 8"
    )
    assert not any(isinstance(item, AttitudeTarget | SetMode | SetArmed) for _, item in flight.heard)
    assert values(flight) == STOCK


def test_on_request_a_stock_arducopter_is_set_up_flown_and_left_as_it_was(lock_step_flight, record):
    flight = stock(lock_step_flight("ardupilot"))
    flight.check_parameters(record, fix=True)
    seen = []

    def look():
        if flight.vehicle.firmware.armed and not seen:
            seen.append((values(flight), record.path.exists()))

    flight.before_slot = look
    result = flight.fly()
    assert result.finished.successful
    assert result.finished.reason == "scenario done, landed"
    assert seen == [(SET, True)]
    assert values(flight) == STOCK
    assert not record.path.exists()
    assert flight.session.changed_parameters == ()


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_reading_parameters_changes_nothing_of_a_flight_that_is_set_up_right(
    lock_step_flight, record, personality
):
    flight = short(lock_step_flight(personality))
    flight.check_parameters(record)
    assert flight.fly().finished.successful
    assert not record.path.exists()


def test_a_stop_while_flying_puts_the_parameters_back_once_the_vehicle_holds(lock_step_flight, record):
    flight = stock(lock_step_flight("ardupilot"))
    flight.check_parameters(record, fix=True)
    result = flight.fly(lambda vehicle: vehicle.state.rigid[2] > 0.5)
    assert result.stopped
    assert flight.vehicle.firmware.mode_name == "BRAKE"
    assert values(flight) == STOCK


def test_a_vehicle_that_stays_in_guided_keeps_the_parameters_and_says_which(lock_step_flight, record):
    """Changing GUID_OPTIONS under a live setpoint would make its thrust a climb rate."""
    flight = stock(lock_step_flight("ardupilot"))
    flight.check_parameters(record, fix=True)
    refuse_brake(flight)
    flight.fly(lambda vehicle: vehicle.state.rigid[2] > 0.5)
    assert values(flight) == SET
    assert {(c.name, c.old) for c in flight.session.changed_parameters} == set(STOCK.items())
    again = short(lock_step_flight("ardupilot"))
    for name, value in SET.items():
        again.vehicle.firmware.parameters.set(name, value)
    again.check_parameters(record)
    again.fly(lambda vehicle: vehicle.time_us > 4_000_000)
    assert values(again) == STOCK
    assert not record.path.exists()


def refuse_brake(flight):
    """An autopilot that does not leave GUIDED when asked."""
    firmware = flight.vehicle.firmware
    honest = firmware.set_custom_mode
    firmware.set_custom_mode = lambda mode: honest(mode) if mode == 4 else type(honest(4)).FAILED


def test_the_same_flight_sends_the_same_bytes_again(lock_step_flight, record):
    def flown():
        flight = stock(lock_step_flight("ardupilot"))
        flight.check_parameters(record, fix=True)
        flight.fly(lambda vehicle: vehicle.state.rigid[2] > 0.2)
        return flight.link.sent

    assert flown() == flown()
