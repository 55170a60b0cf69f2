"""Priorities of a run's processes where cores are few: the way from a sample to its estimate is short only if nobody waits for a core.

Broker, machine, twin and watch compute for some tens of microseconds and sleep again. Where the system allows it (root, or a limit for
real-time priorities) they have one of the lowest of these; elsewhere they ask Linux for short turns, in return for being woken at once.
The recorder comes next, for it must not fall behind. What is looked at by people, and what looks ahead, is patient. Whatever has been
killed is in a hurry until it works again.
"""

import contextlib
import ctypes
import os
import platform
from typing import Final

FIRST: Final = ("broker", "machine", "follow", "watch")
LAST: Final = ("forecast", "dashboard")

PATIENCE: Final = 10
"""The niceness of those that come last, where there is no real-time priority."""

TURN_NS: Final = 100_000
"""Of those that go first, where there is no real-time priority; Linux's own turns last milliseconds."""

SCHED_SETATTR: Final = {"x86_64": 314, "aarch64": 274}
"""The number of the call, which libraries of C have no name for before glibc 2.41."""


class _Attributes(ctypes.Structure):
    """`struct sched_attr` of Linux, of which an ordinary process has niceness and turn (`sched_runtime`, since Linux 6.12)."""

    _fields_ = (
        *((name, ctypes.c_uint32) for name in ("size", "policy")),
        ("flags", ctypes.c_uint64),
        ("nice", ctypes.c_int32),
        ("priority", ctypes.c_uint32),
        *((name, ctypes.c_uint64) for name in ("runtime", "deadline", "period")),
    )


def hurry(pid: int) -> None:
    """A process that has just been started may load its packages before others go on, but not before those that go first."""
    _real_time(pid, 0)


def take(name: str) -> None:
    """Gives the calling process the priority of its name; threads that it makes afterwards inherit it."""
    allowed = _real_time(0, int(name in FIRST))
    if name in FIRST and not allowed:
        _short_turns()
    if name in LAST:
        with contextlib.suppress(OSError):
            if allowed:
                # Behind the others as it is.
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
            elif hasattr(os, "nice"):
                os.nice(PATIENCE)


def _real_time(pid: int, above: int) -> bool:
    """Whether the system allows it."""
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
        # An older kernel does not look at it, or refuses it: then all is as usual.
        ctypes.CDLL(None).syscall(number, 0, ctypes.byref(attributes), 0)
