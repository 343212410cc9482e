"""Asking the operating system for punctuality: what is asked, and what is said when it refuses."""

import ctypes
import errno
import gc
import os
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from kffa_offboard.process import realtime
from kffa_offboard.process.realtime import Collector, RealtimeSettings, become_real_time


@pytest.fixture
def system(monkeypatch, tmp_path):
    """An operating system that takes note and, if told to, refuses."""
    asked = SimpleNamespace(refuses=False, scheduled={}, cores=None, locked=None)

    def refuse():
        if asked.refuses:
            raise PermissionError(errno.EPERM, "Operation not permitted")

    def schedule(thread, policy, parameters):
        refuse()
        assert policy == os.SCHED_FIFO
        asked.scheduled[thread] = parameters.sched_priority

    def pin(thread, cores):
        refuse()
        asked.cores = cores

    def lock(flags):
        asked.locked = flags
        ctypes.set_errno(errno.ENOMEM)
        return -1 if asked.refuses else 0

    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    monkeypatch.setattr(os, "sched_setaffinity", pin)
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: SimpleNamespace(mlockall=lock))
    monkeypatch.setattr(realtime, "LATENCY_DEVICE", str(tmp_path / "cpu_dma_latency"))
    before = sys.getswitchinterval()
    yield asked
    sys.setswitchinterval(before)


def test_the_control_loop_goes_before_the_other_threads_of_the_process(system):
    done = threading.Event()
    other = threading.Thread(target=done.wait)
    other.start()
    try:
        assert become_real_time(RealtimeSettings(priority=40)) == []
    finally:
        done.set()
        other.join()
    assert system.scheduled[threading.get_native_id()] == 40
    assert system.scheduled[other.native_id] == 39
    assert system.cores == {max(os.sched_getaffinity(0))}
    assert system.locked == 7


def test_each_thing_can_be_left_out(system):
    assert become_real_time(RealtimeSettings(priority=0, pin=False, lock_memory=False)) == []
    assert (system.scheduled, system.cores, system.locked) == ({}, None, None)


def test_the_processor_is_kept_awake_for_as_long_as_the_process_lives(system, tmp_path):
    device = tmp_path / "cpu_dma_latency"
    device.touch()
    assert become_real_time(RealtimeSettings(keep_awake=True)) == []
    assert device.read_bytes() == bytes(4), "0 us, as 32 bits"
    open_files = {os.path.realpath(entry) for entry in Path("/proc/self/fd").iterdir()}
    assert str(device) in open_files


def test_that_it_cannot_be_kept_awake_is_said(system):
    (line,) = become_real_time(RealtimeSettings(keep_awake=True))
    assert line.startswith("cannot keep the processor awake (realtime.keep_awake): no such file")


def test_each_refusal_is_a_line_with_its_remedy(system):
    system.refuses = True
    lines = become_real_time(RealtimeSettings(core=3))
    assert len(lines) == 3
    assert all(line.startswith("cannot ") and "\n" not in line for line in lines)
    memory, core, scheduling = lines
    assert "realtime.lock_memory" in memory and "LimitMEMLOCK=infinity" in memory
    assert "core 3" in core and "CPUAffinity=" in core
    assert "not permitted; give it CAP_SYS_NICE, or LimitRTPRIO=50 in the unit" in scheduling


def test_garbage_is_collected_after_steps_once_in_a_period_and_never_in_between():
    collections = []
    collector = Collector(1.0)
    gc.callbacks.append(lambda phase, _: collections.append(phase))
    try:
        collector.freeze()
        assert gc.get_freeze_count() > 10_000
        assert not gc.isenabled()
        collections.clear()
        for now_us in range(10_000_000, 13_000_000, 10_000):
            loop = []
            loop.append(loop)
            collector.step_done(now_us)
        assert collections == ["start", "stop"] * 3
    finally:
        gc.callbacks.pop()
        collector.restore()
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0


def test_without_real_time_the_collector_stays_on():
    collector = Collector(None)
    try:
        collector.freeze()
        assert gc.isenabled()
    finally:
        collector.restore()
