"""Being punctual on a busy computer: Linux real-time scheduling, locked memory, one core, a tamed collector.

SCHED_FIFO (sched(7)) lets the control loop run before all ordinary processes. The other threads (log, status)
get the priority below it, not an ordinary one: a thread that waits for a core while it holds the interpreter
would keep the control loop waiting, too. Memory is locked as it is touched (mlock(2), MCL_ONFAULT), since
locking all that is mapped at once would take hundreds of MiB.
"""

from __future__ import annotations

import ctypes
import errno
import gc
import os
import struct
import sys
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
LATENCY_DEVICE = "/dev/cpu_dma_latency"
_SWITCH_INTERVAL_S = 1e-4
"""How long another thread may hold the interpreter when the control loop wants it; Python's own is 5 ms."""


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """What is asked of the operating system.

    Attributes
    ----------
    enabled : ask for anything at all
    required : do not fly if something is not permitted
    priority : of SCHED_FIFO, 1 to 99; 0 leaves scheduling alone
    pin : stay on one core
    core : which one; None for the last that is allowed
    lock_memory : never be paged out
    keep_awake : the processor does not sleep while it waits, which costs power; it wakes up at once
    collect_s : how often garbage is collected, right after a control step
    """

    enabled: bool = False
    required: bool = True
    priority: int = 50
    pin: bool = True
    core: int | None = None
    lock_memory: bool = True
    keep_awake: bool = False
    collect_s: float = 1.0


def become_real_time(settings: RealtimeSettings) -> list[str]:
    """Do what the settings ask for; return what was not permitted, one line each, with the remedy.

    To be called by the thread that controls, when all others run.
    """
    problems: list[str] = []
    steps: list[Callable[[RealtimeSettings], None]] = []
    if settings.lock_memory:
        steps.append(_lock_memory)
    if settings.keep_awake:
        steps.append(_keep_awake)
    if settings.pin:
        steps.append(_pin)
    if settings.priority > 0:
        steps.append(_schedule)
    for step in steps:
        try:
            step(settings)
        except OSError as error:
            problems.append(_explain(step, settings, error))
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    return problems


def _lock_memory(settings: RealtimeSettings) -> None:
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _keep_awake(settings: RealtimeSettings) -> None:
    """Ask for 0 us of latency (pm_qos); the kernel forgets it when the process ends, however it does."""
    request = os.open(LATENCY_DEVICE, os.O_WRONLY | os.O_CLOEXEC)
    os.write(request, struct.pack("=i", 0))


def _pin(settings: RealtimeSettings) -> None:
    os.sched_setaffinity(0, {_core(settings)})


def _core(settings: RealtimeSettings) -> int:
    return max(os.sched_getaffinity(0)) if settings.core is None else settings.core


def _schedule(settings: RealtimeSettings) -> None:
    own = threading.get_native_id()
    for entry in Path("/proc/self/task").iterdir():
        thread = int(entry.name)
        priority = settings.priority if thread == own else max(1, settings.priority - 1)
        try:
            os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(priority))
        except ProcessLookupError:
            continue  # it has ended meanwhile


def _explain(step: Callable[[RealtimeSettings], None], settings: RealtimeSettings, error: OSError) -> str:
    if step is _lock_memory:
        what, remedy = (
            "lock its memory (realtime.lock_memory)",
            "give it CAP_IPC_LOCK or LimitMEMLOCK=infinity in the unit (ulimit -l unlimited)",
        )
    elif step is _keep_awake:
        what = "keep the processor awake (realtime.keep_awake)"
        remedy = f"let it write to {LATENCY_DEVICE} (docs/deployment.md), or leave that out"
    elif step is _pin:
        allowed = ",".join(map(str, sorted(os.sched_getaffinity(0))))
        what = f"stay on core {_core(settings)} (realtime.core)"
        remedy = f"choose one of {allowed}, or CPUAffinity= in the unit"
    else:
        what = f"run with SCHED_FIFO priority {settings.priority} (realtime.priority)"
        remedy = f"give it CAP_SYS_NICE, or LimitRTPRIO={settings.priority} in the unit (ulimit -r)"
    reason = (
        "not permitted"
        if error.errno in (errno.EPERM, errno.EACCES, errno.ENOMEM)
        else (error.strerror or "failed").lower()
    )
    return f"cannot {what}: {reason}; {remedy}"


class Collector:
    """Python's garbage collector, at moments of our choosing.

    `freeze` puts what was made up to the start out of its sight: 0.2 million objects of libraries, which it
    would look at again and again. With `collect_s` it is switched off, and `step_done` collects.
    """

    def __init__(self, collect_s: float | None) -> None:
        self._period_us = None if collect_s is None else round(collect_s * 1e6)
        self._collected_us = 0

    def freeze(self) -> None:
        """Call it once, when everything is set up."""
        gc.collect()
        gc.freeze()
        if self._period_us is not None:
            gc.disable()

    def step_done(self, now_us: int) -> None:
        """A setpoint has just left: the longest time until the next one begins."""
        if self._period_us is not None and now_us - self._collected_us >= self._period_us:
            self._collected_us = now_us
            gc.collect()

    def restore(self) -> None:
        """As it was before, for programs that go on."""
        gc.unfreeze()
        gc.enable()
