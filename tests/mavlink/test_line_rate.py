"""A serial line that is too slow for the flight is said before it delays control."""

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard import cli
from kffa_offboard.config import bundled
from kffa_offboard.mavlink.address import parse_url
from kffa_offboard.mavlink.line_rate import line_load, too_slow
from kffa_offboard.offboard.settings import TelemetrySettings

TELEMETRY = TelemetrySettings()  # 100 Hz of attitude and position


def said(url, signals_hz=0.0, signed=False, telemetry=TELEMETRY):
    return too_slow(parse_url(url), telemetry, signals_hz, signed=signed)


def test_the_load_is_that_of_the_frames_on_the_wire():
    """What pymavlink packs, with values that leave no zeros to be cut off."""
    mav = mavlink.MAVLink(None)
    attitude = mavlink.MAVLink_attitude_message(2**31, *[1.1] * 6).pack(mav)
    position = mavlink.MAVLink_local_position_ned_message(2**31, *[1.1] * 6).pack(mav)
    setpoint = mavlink.MAVLink_set_attitude_target_message(2**31, 1, 1, 7, [1.1] * 4, *[1.1] * 4).pack(mav)
    quiet = TelemetrySettings(
        attitude_hz=100.0, position_hz=50.0, target_hz=1e-9, status_hz=1e-9, heartbeat_hz=1e-9
    )
    load = line_load(quiet, 0.0, signed=False)
    assert load.received == pytest.approx(100 * len(attitude) + 50 * len(position), abs=0.01)
    assert load.sent == 100 * len(setpoint)
    signed = line_load(quiet, 0.0, signed=True)
    assert signed.sent - load.sent == 100 * 13, "a signature has 13 bytes"


def test_signals_ten_times_a_second_take_nine_kilobytes():
    with_signals, without = (line_load(TELEMETRY, hz, signed=False) for hz in (10.0, 0.0))
    assert with_signals.sent - without.sent == pytest.approx(9000.0, rel=0.05)
    assert with_signals.received == without.received


def test_57600_baud_do_not_carry_a_flight_and_the_remedy_is_a_rate_that_does():
    text = said("serial:/dev/ttyUSB0:57600")
    assert text.startswith(
        "serial:/dev/ttyUSB0:57600 carries 5.8 kB/s, and the flight takes 9.6 from the vehicle"
    )
    assert text.endswith("use 115200 baud")
    assert said("serial:/dev/ttyUSB0:115200") is None


def test_what_is_too_much_may_be_the_signals_alone():
    text = said("serial:/dev/ttyUSB0:115200", signals_hz=10.0)
    assert text.endswith("use 230400 baud or a lower signals.rate_hz")
    assert said("serial:/dev/ttyUSB0:115200", signals_hz=2.0) is None
    assert said("serial:/dev/ttyUSB0:115200", signed=True).endswith("use 230400 baud")


@pytest.mark.parametrize("url", ["serial:/dev/ttyACM0:57600", "udpin:127.0.0.1:14540", "tcp:127.0.0.1:5760"])
def test_usb_and_networks_have_no_such_rate(url):
    assert said(url, signals_hz=10.0) is None


def test_a_name_by_id_of_an_autopilot_s_usb_port_is_followed(tmp_path):
    (tmp_path / "ttyACM0").touch()
    (tmp_path / "usb-autopilot").symlink_to(tmp_path / "ttyACM0")
    assert said(f"serial:{tmp_path}/usb-autopilot:57600") is None


def test_check_says_it_and_finds_nothing_wrong(tmp_path, capsys):
    config = tmp_path / "slow.toml"
    usual = bundled("serial.toml").read_text(encoding="utf-8")
    config.write_text(usual.replace('921600"', '57600"'), encoding="utf-8")
    with pytest.raises(SystemExit) as ended:
        cli.main(["check", str(config)])
    assert not ended.value.code
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith(f"{config}: ok")
    assert second.startswith(f"{config}: warning: serial:/dev/ttyUSB0:57600 carries 5.8 kB/s")
