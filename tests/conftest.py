"""Settings that hold for every test: the same examples on every run, no wall-clock deadlines, one thread."""

import json
import os
import socket
import subprocess
import sys
import time

import pytest
from hypothesis import settings

settings.register_profile("deterministic", derandomize=True, deadline=None, max_examples=60)
settings.load_profile("deterministic")

# Before numpy is imported: threads of its matrices that wait for a core do so by computing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

SWING = [
    {"type": "takeoff", "altitude_m": 2.0, "climb_rate_m_s": 1.5},
    {"type": "sine", "channel": "roll", "amplitude_deg": 15.0, "period_s": 2.0, "cycles": 30},
]
FAST_RAD_S = 0.5


def pytest_addoption(parser):
    parser.addoption("--bless", action="store_true", help="fly the golden flights again and keep them")


def _end_in_the_swing(config, truth, number, *options):
    """Fly `SWING` in real time and send the daemon a signal while it rolls fast.

    Returns when that was, s of simulated time.
    """
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ear:
        ear.bind(("127.0.0.1", 0))
        ear.settimeout(60.0)
        command = [sys.executable, "-m", "kffa_offboard", "run", "--config", str(config), *options]
        command += ["--arm", "--engage", "--plot", f"udpout:127.0.0.1:{ear.getsockname()[1]}"]
        daemon = subprocess.Popen(command, cwd=config.parent, stderr=subprocess.DEVNULL)
        limit = time.monotonic() + 60.0
        try:
            while abs(json.loads(ear.recv(65535)).get("roll/estimate_rate", 0.0)) < FAST_RAD_S:
                assert time.monotonic() < limit, "it does not swing"
            daemon.send_signal(number)
            sent_s = float(truth.read_text(encoding="utf-8").splitlines()[-2].split(",")[0])
            time.sleep(1.5)
            return sent_s
        finally:
            daemon.kill()
            daemon.wait()


@pytest.fixture(scope="session")
def end_in_the_swing():
    """Makes a daemon die or halt in a fast roll."""
    return _end_in_the_swing


@pytest.fixture(scope="session")
def swing():
    """Segments of that flight."""
    return SWING
