"""The same faults in real time: vehicle and daemon on UDP, and a proxy with faults between them."""

import subprocess
import sys
import threading
from dataclasses import replace

import pytest
from pymavlink.dialects.v20 import ardupilotmega as mavlink

from kffa_offboard.config import Overrides, bundled, load
from kffa_offboard.faults.faults import Flood, Lose
from kffa_offboard.faults.line import FaultLine
from kffa_offboard.faults.proxy import FaultProxy
from kffa_offboard.mavlink.component import Route
from kffa_offboard.mavlink.link import open_link
from kffa_offboard.mavlink.session import Session
from kffa_offboard.mavlink.shell import real_time_clock, run_real_time
from kffa_offboard.offboard import events
from kffa_offboard.offboard.segments import Hold, Takeoff
from kffa_offboard.offboard.service import Service

NEVER = 1e6  # s; until the test says when
FOREIGN = bytes(mavlink.MAVLink_attitude_message(1, 0, 0, 0, 0, 0, 0).pack(mavlink.MAVLink(None, 77, 1)))


def fly(fault):
    """Take off, and let the fault begin half a second after lift-off is allowed; texts with their times."""
    daemon = load(bundled("demo-px4.toml"), Overrides(controller=None, output=None, arm=True, engage=True))
    clock, heard, stop = real_time_clock(), [], threading.Event()
    link = open_link("udpin:127.0.0.1:0", clock)
    proxy = FaultProxy(int(link.name.rpartition(":")[2]), FaultLine((fault,)), FaultLine(()))

    def observe(time_us, item):
        if isinstance(item, events.Announce):
            heard.append((time_us * 1e-6, item.text))
            if item.text == "engaged":
                fault.start_s = proxy.elapsed_s + 0.5
                heard.append((time_us * 1e-6 + 0.5, "fault"))

    service = Service(replace(daemon.service, scenario=(Takeoff(1.0, 1.0), Hold(1.0))))
    session = Session(service, link, Route(), observer=observe)
    command = [sys.executable, "-m", "sim_vehicle", "run", "--config", str(bundled("sim-px4.toml"))]
    command += ["--link", f"udpout:127.0.0.1:{proxy.vehicle_port}"]
    with proxy.running(), subprocess.Popen(command, stdout=subprocess.DEVNULL) as vehicle:
        try:
            run_real_time(session, clock, stop, connect_timeout_s=30.0)
        finally:
            vehicle.kill()
            link.close()
    return heard, session


@pytest.mark.timeout(120)
def test_a_link_that_falls_silent_ends_control_within_its_time():
    """Where the machine itself stands still for 0.25 s before control is taken, another flight is made."""
    for _ in range(3):
        heard, _ = fly(Lose(NEVER))
        times = {text: time_s for time_s, text in heard}
        if "fault" in times:
            break
    assert "fault" in times, heard
    assert "failsafe: no attitude for 0.25 s" in times, heard
    assert times["failsafe: no attitude for 0.25 s"] - times["fault"] <= 1.0


@pytest.mark.timeout(60)
def test_a_flood_of_another_system_is_survived_and_no_telemetry_of_it_taken():
    """20,000 frames/s; a slow machine may lose telemetry in it, and control then ends as announced."""
    _, session = fly(Flood(NEVER, 1.0, frames=(FOREIGN,)))
    assert (77, 1) in session.heard or session.service.finished is not None
    assert session.service.finished.successful or "failsafe" in session.service.finished.reason
