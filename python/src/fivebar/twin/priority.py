"""Priorities of a run's processes: on few cores, the latency from a sample to its estimate is short only if no process waits for a core.

Broker, machine, twin and watch compute for some tens of microseconds and sleep again. If the system allows it (root, or a limit for
real-time priorities), they get a low real-time priority; otherwise they ask Linux for short time slices, with which it wakes them at once.
The recorder comes next, because it must not fall behind. Dashboard and forecasts come last. A restarted process has a raised priority
until it is ready.
"""

import contextlib
import ctypes
import os
import platform
from typing import Final

FIRST: Final = ("broker", "machine", "follow", "watch")
LAST: Final = ("forecast", "dashboard")

PATIENCE: Final = 10
"""Niceness of the last processes without real-time priorities."""

TURN_NS: Final = 100_000
"""Time slice of the first processes without real-time priorities; Linux's default is some milliseconds."""

SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""Number of the system call, by machine; glibc has no function for it before 2.41."""


class _Attributes(ctypes.Structure):
    """`struct sched_attr` of Linux. An ordinary process uses its niceness and time slice (`sched_runtime`, since Linux 6.12)."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("size", "policy")),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        *((name, ctypes.c_uint64) for name in ("runtime", "deadline", "period")),
    )


def hurry(pid: int) -> None:
    """Raises the priority of a new process while it imports its packages, but not above the first processes."""
    _real_time(pid, 0)


def take(name: str) -> None:
    """Gives the calling process the priority for its name; threads that start later inherit it."""
    allowed = _real_time(0, int(name in FIRST))
    if name in FIRST and not allowed:
        _short_turns()
    if name in LAST:
        with contextlib.suppress(OSError):
            if allowed:
                # An ordinary process already comes after the real-time ones.
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            elif hasattr(os, "nice"):
                os.nice(PATIENCE)


def _real_time(pid: int, above: int) -> bool:
    """Sets a real-time priority and returns whether the system allows it."""
    if not hasattr(os, "sched_setscheduler"):
        return False
    try:
        os.sched_setscheduler(pid, os.SCHED_RR, os.sched_param(os.sched_get_priority_min(os.SCHED_RR) + above))
    except OSError:
        return False
    return True


def _short_turns() -> None:
    number = SCHED_SETATTR.get(platform.machine())
    if number is not None and platform.system() == "Linux":
        attributes = _Attributes(size=ctypes.sizeof(_Attributes), runtime=TURN_NS)
        # An older kernel ignores or refuses the request: the default time slice remains.
        ctypes.CDLL(None).syscall(number, 0, ctypes.byref(attributes), 0)
