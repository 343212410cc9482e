"""A process is known to be idle without being asked."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from kffa_offboard.compare.idle import Threads
from kffa_offboard.trials.processes import process

pytestmark = pytest.mark.skipif(not Threads.can_be_seen(), reason="this system has no /proc with schedstat")

WORKER = """
import sys, threading
turns = 0
def work():
    global turns
    for line in sys.stdin:
        end = int(line)
        while turns < end:
            turns += 1
        print(turns, flush=True)
worker = threading.Thread(target=work)
worker.start()
worker.join()
"""


def test_a_process_whose_threads_work_is_not_idle_until_they_are_done() -> None:
    with subprocess.Popen(
        [sys.executable, "-c", WORKER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as child:
        threads = Threads(child.pid)
        try:
            assert child.stdin is not None
            assert child.stdout is not None
            for end in (1, 2_000_000, 2_000_001, 4_000_000):
                child.stdin.write(f"{end}\n")
                child.stdin.flush()
                assert threads.wait_until_idle(60.0)
                os.set_blocking(child.stdout.fileno(), False)
                assert child.stdout.readline() == f"{end}\n"
        finally:
            threads.close()
            child.stdin.close()


def test_a_process_that_is_never_idle_is_waited_for_no_longer_than_the_limit() -> None:
    with process([sys.executable, "-c", "while True: pass"]) as child:
        threads = Threads(child.pid)
        assert not threads.wait_until_idle(0.2)
        threads.close()


def test_a_process_that_has_ended_is_not_waited_for() -> None:
    with process([sys.executable, "-c", ""]) as child:
        child.wait()
    assert Threads(child.pid).wait_until_idle(0.0)
