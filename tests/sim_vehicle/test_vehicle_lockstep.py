"""The vehicle as a whole, fed in-process: repeatability, link delays, loads, truth."""

from __future__ import annotations

import csv
import io

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from sim_vehicle.truth import COLUMNS, TruthFile

ATTITUDE = mavlink.MAVLINK_MSG_ID_ATTITUDE
SCHEDULE = [{"time_s": 1.0, "mass_kg": 5.0}, {"time_s": 2.0, "mass_kg": 0.0}]


def flight(make_pilot, personality: str, seed: int) -> bytes:
    """All bytes of a flight with gusts, jitter and a load."""
    pilot = make_pilot(
        personality,
        parameters={"GUID_OPTIONS": 8} if personality == "ardupilot" else {},
        vehicle={"seed": seed},
        link={"telemetry_delay_s": 0.02, "command_delay_s": 0.02, "jitter_s": 0.01},
        wind={"gust_std_m_s": 1.0},
        payload={"schedule": SCHEDULE},
    )
    pilot.engage_in_flight()
    pilot.run(2.5, lambda: pilot.setpoint(rates=(0.1, 0.0, 0.0)))
    return pilot.bytes


@pytest.mark.parametrize("personality", ["px4", "ardupilot"])
def test_one_seed_gives_the_same_bytes_and_another_seed_others(make_pilot, personality):
    first, again = flight(make_pilot, personality, 1), flight(make_pilot, personality, 1)
    assert len(first) > 4_000
    assert first == again
    assert first != flight(make_pilot, personality, 2)


def test_how_time_is_cut_makes_no_difference(make_pilot):
    together, apart = make_pilot("px4"), make_pilot("px4")
    together.run(2.0, every=0.5)
    apart.run(2.0, every=0.0025)
    assert together.bytes == apart.bytes


def test_nothing_goes_beyond_the_time_asked_for(px4):
    px4.vehicle.advance(12_400)
    assert px4.vehicle.time_us == 10_000
    px4.vehicle.advance(12_500)
    assert px4.vehicle.time_us == 12_500


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.1])
def test_a_command_acts_after_the_link_delay(make_pilot, delay):
    pilot = make_pilot("ardupilot", link={"telemetry_delay_s": 0.0, "command_delay_s": delay})
    pilot.run(0.1)
    asked = pilot.now
    pilot.command(mavlink.MAV_CMD_DO_SET_MODE, 1, 4)
    pilot.run(0.3)
    assert pilot.vehicle.truth.time_of("mode GUIDED") - asked == pytest.approx(delay, abs=0.003)


def test_jitter_delays_datagrams_but_never_reorders_them(make_pilot):
    pilot = make_pilot("px4", link={"telemetry_delay_s": 0.0, "command_delay_s": 0.0, "jitter_s": 0.05})
    pilot.run(2.0, every=0.0025)
    sent = [message.time_boot_ms for message in pilot.messages("ATTITUDE")]
    late = [
        time - message.time_boot_ms * 1e-3
        for time, message in pilot.received
        if message.get_type() == "ATTITUDE"
    ]
    assert sent == sorted(sent)
    assert 0.02 < sum(late) / len(late) < 0.06
    assert max(late) < 0.056


def test_everybody_hears_the_heartbeat_until_the_first_peer_is_known(px4):
    px4.vehicle.advance(1_000_000)
    assert {key for key, _ in px4.vehicle.outgoing()} == {None}
    px4.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 0)
    px4.vehicle.advance(2_000_000)
    assert {key for key, _ in px4.vehicle.outgoing()} == {"pilot"}


# ---------------------------------------------------------------------------------------- load


def test_an_airborne_schedule_counts_from_lift_off(make_pilot):
    pilot = make_pilot("px4", payload={"schedule": SCHEDULE})
    pilot.run(2.5, pilot.setpoint)
    assert pilot.vehicle.truth.time_of("pick-up") is None
    pilot.engage_in_flight()
    lifted = pilot.now - 0.3
    pilot.run(2.2, lambda: pilot.setpoint(thrust=0.5))
    assert pilot.vehicle.truth.time_of("pick-up 5 kg") - lifted == pytest.approx(1.0, abs=0.02)
    assert pilot.vehicle.truth.time_of("drop 5 kg") - lifted == pytest.approx(2.0, abs=0.02)


def test_a_boot_schedule_counts_from_power_up(make_pilot):
    pilot = make_pilot("px4", payload={"schedule": SCHEDULE, "clock": "boot"})
    pilot.run(2.1)
    assert pilot.vehicle.truth.time_of("pick-up") == pytest.approx(1.0, abs=0.003)
    assert pilot.vehicle.truth.time_of("drop") == pytest.approx(2.0, abs=0.003)


def test_the_gripper_takes_the_configured_mass(make_pilot):
    pilot = make_pilot("ardupilot", payload={"gripper_mass_kg": 1.5})
    pilot.ask(mavlink.MAV_CMD_DO_GRIPPER, 1, mavlink.GRIPPER_ACTION_GRAB)
    assert pilot.vehicle.state.load_mass == 1.5


def test_the_papers_profile_flies_too(make_pilot):
    pilot = make_pilot("px4", vehicle={"profile": "paper"})
    pilot.take_off()
    assert pilot.height == pytest.approx(2.5, abs=0.15)


@pytest.mark.parametrize("wind", [{"mean_m_s": [8.0, 0.0, 0.0]}, {"sine_amplitude_n": 10.0}])
def test_wind_moves_the_vehicle(make_pilot, wind):
    calm, windy = make_pilot("px4"), make_pilot("px4", wind=wind)
    for pilot in (calm, windy):
        pilot.engage_in_flight()
        pilot.run(2.0, lambda pilot=pilot: pilot.setpoint(7))
    gap = calm.vehicle.state.position - windy.vehicle.state.position
    assert abs(gap).max() > 0.15


# --------------------------------------------------------------------------------------- truth


def test_truth_has_a_row_every_10_ms_and_each_event_once(px4):
    px4.take_off()
    rows, events = px4.vehicle.truth.rows, px4.vehicle.truth.events
    assert [row.time_s for row in rows[:200]] == pytest.approx([0.01 * n for n in range(200)])
    texts = "; ".join(row.event for row in rows if row.event).split("; ")
    assert texts == [event.text for event in events]
    assert texts[:4] == ["armed", "mode TAKEOFF", "takeoff", "mode HOLD"]
    assert rows[-1].armed and rows[-1].mode == "HOLD"


def test_truth_as_csv_has_the_promised_columns(px4):
    stream = io.StringIO()
    record = TruthFile(stream, px4.vehicle.truth)
    px4.vehicle.set_load(2.0)
    px4.run(0.5)
    record.flush()
    px4.run(0.5)
    record.flush()
    assert px4.vehicle.truth.rows == [], "a day of them would fill the memory"
    rows = list(csv.DictReader(io.StringIO(stream.getvalue())))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 101
    assert [row["event"] for row in rows if row["event"]] == ["pick-up 2 kg"]
    assert rows[-1]["load_mass_kg"] == "2"
