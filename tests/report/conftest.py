"""A hand-made flight whose figures are known, and the browser."""

import math
import shutil

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.flightlog.notes import Header
from kffa_offboard.flightlog.writer import TlogWriter
from kffa_offboard.mavlink import commands
from kffa_offboard.offboard.events import Announce, PayloadReport, Severity, Signals

BEGIN_US = 1_700_000_000_000_000
STEP_US = 10_000


@pytest.fixture
def write_log():
    """Writes a flight of `duration_s` at 100 Hz: engaging at 1 s, engaged from 2 s, 2 kg picked up at 4 s.

    Each channel is 0.1 rad or 0.1 m behind its reference. There is no telemetry from 6.0 s to 6.5 s.
    """
    vehicle = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    daemon = mavlink.MAVLink(None, srcSystem=245, srcComponent=191)

    def write(path, duration_s=8.0, end=True, signals=True, text="hello <b>pilot</b></script>", part=1):
        header = Header("1.2.3", {"control": {"controller": "ladrc", "output": "rates"}}, {}, part=part)
        with TlogWriter(path, header=header if signals else None) as log:
            log.write_begin(BEGIN_US)

            def send(time_us, message, sender=vehicle):
                log.write(time_us, bytes(message.pack(sender)))

            for step in range(round(duration_s * 100)):
                time_us = BEGIN_US + step * STEP_US
                if step % 50 == 0:
                    send(time_us, heartbeat(armed=step >= 150))
                if not 600 <= step < 650:
                    send(time_us, mavlink.MAVLink_attitude_message(step * 10, 0.1, 0.0, 0.0, 0, 0, 0))
                    position = (step * 10, 0.0, 0.0, -5.0, 0.0, 0.0, 0.0)
                    send(time_us, mavlink.MAVLink_local_position_ned_message(*position))
                    if signals:
                        log.write_signals(inner_signals(time_us, step))
                if step == 100:
                    send(time_us, mavlink.MAVLink_statustext_message(6, text.encode()))
                if step == 400 and signals:
                    picked = Announce(Severity.NOTICE, "picked up 2.0 kg")
                    for message in commands.status_text(picked, 1):
                        send(time_us, message, daemon)
                if step >= 400 and step % 20 == 0 and signals:
                    for message in commands.payload_report(PayloadReport(time_us, 2.0, 0.1)):
                        send(time_us, message, daemon)
            if end:
                log.write_end(time_us, "landed", 3)
        return path

    return write


def heartbeat(armed):
    mode = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    mode |= mavlink.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
    return mavlink.MAVLink_heartbeat_message(
        mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, mode, 6 << 16, 4, 3
    )


def inner_signals(time_us, step):
    state = "ready" if step < 100 else "engaging" if step < 200 else "engaged"
    reference = (0.3, -0.2, math.pi - 0.05, 5.0 if step >= 100 else 4.0)
    measured = (0.2, -0.3, -math.pi + 0.05 - 0.2, 4.9)
    disturbance = (0.0, 0.0, 0.0, math.nan if step < 50 else -9.8)
    return Signals(
        time_us,
        state,
        reference,
        (0.0,) * 4,
        measured,
        (0.25, -0.25, math.pi - 0.1, 4.96),
        (0.0,) * 4,
        disturbance,
        (4.0, 4.0, 2.0, 8.0),
        (0.5, 0.0, 0.0, 0.4),
        (0.5, 0.0, 0.0, 0.4),
        (step % 4 == 0, False, False, False),
        0.01,
        0.020 if step % 50 else 0.120,
    )


@pytest.fixture(scope="session")
def chromium():
    """A headless browser; tests that need one are skipped without."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"):
        found = shutil.which(name)
        if found is not None:
            return found
    pytest.skip("no chromium or chrome on this machine: the page is not opened")


@pytest.fixture
def noise():
    return np.random.default_rng(0)
