"""A clock that is set while a log is written, and what only looks like it."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.tlog import TIMESTAMP, clock_remarks, read_tlog
from kffa_offboard.report.read import read_flight

START_US = 1_700_000_000_000_000
SET_AT_S = 5.0


def record(time_s, message, system=1):
    sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=1)
    return TIMESTAMP.pack(START_US + round(time_s * 1e6)) + bytes(message.pack(sender))


def heartbeat():
    return mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, 128 + 64, 6 << 16, 4, 3)


def write(path, clock, duration_s=10.0, boot=lambda time_s: time_s):
    """10 Hz of attitude, each after a heartbeat; `clock` is what the computer's clock shows at a time."""
    times = [n / 10.0 for n in range(round(10 * duration_s))]
    data = b""
    for time_s in times:
        attitude = mavlink.MAVLink_attitude_message(round(1e3 * boot(time_s)), 0.1, 0, 0, 0, 0, 0)
        data += record(clock(time_s), heartbeat()) + record(clock(time_s), attitude)
    path.write_bytes(data)
    return times


def times_in(path):
    reader = read_tlog(path, even=True)
    return [(time_us - START_US) / 1e6 for time_us, m in reader if m.get_type() == "ATTITUDE"], reader


@pytest.mark.parametrize("step_s", [3600.0, -3600.0, 1.7e9, -2.0])
def test_a_clock_that_is_set_in_flight_moves_no_sample(tmp_path, step_s):
    path = tmp_path / "flight.tlog"
    times = write(path, lambda time_s: time_s + (step_s if time_s >= SET_AT_S else 0.0))
    found, reader = times_in(path)
    assert found == pytest.approx(times, abs=0.11)
    assert reader.clock_steps_s == pytest.approx([step_s], abs=0.11)
    assert "the log was set by" in clock_remarks(reader)[0]
    flight = read_flight(path)
    assert flight.duration_s == pytest.approx(times[-1], abs=0.2)
    assert any("clock of the computer" in remark for remark in flight.remarks)


def test_a_pause_of_the_link_is_no_step(tmp_path):
    path = tmp_path / "flight.tlog"
    times = write(path, lambda time_s: time_s, boot=lambda time_s: time_s)
    long_ago = path.read_bytes()
    write(path, lambda time_s: time_s + 300.0, boot=lambda time_s: time_s + 300.0)
    path.write_bytes(long_ago + path.read_bytes())
    found, reader = times_in(path)
    assert found == [*times, *(time_s + 300.0 for time_s in times)]
    assert clock_remarks(reader) == []


def test_a_restart_after_a_long_pause_is_no_step(tmp_path):
    path = tmp_path / "flight.tlog"
    write(path, lambda time_s: time_s)
    first = path.read_bytes()
    write(path, lambda time_s: time_s + 86_400.0)
    path.write_bytes(first + path.read_bytes())
    found, reader = times_in(path)
    assert found[-1] == pytest.approx(86_409.9)
    assert clock_remarks(reader) == []


def test_one_damaged_time_moves_nothing_else(tmp_path):
    path = tmp_path / "flight.tlog"
    times = write(path, lambda time_s: time_s)
    data = path.read_bytes()
    path.write_bytes(data + record(1e6, heartbeat()) + record(10.0, heartbeat()))
    found, reader = times_in(path)
    assert found == times
    assert [(time_us - START_US) / 1e6 for time_us, _ in reader][-2:] == [1e6, 10.0]
    assert clock_remarks(reader) == []
