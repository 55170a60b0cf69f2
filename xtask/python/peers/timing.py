"""Number of repeats of a run, and the time that counts; the same for all programs."""

from statistics import median

# A run longer than LONG s is not repeated. Shorter runs are made at least LEAST times, and up to MOST times while their sum is below
# TOGETHER s.
LONG, LEAST, MOST, TOGETHER = 0.5, 5, 20, 0.2

# Other work on the host can slow a program for minutes. All runs shorter than LONG s are therefore measured in rounds, one after the other,
# and the fastest round of each run counts.
ROUNDS = 3


def enough(times: list[float]) -> bool:
    """Whether these times of one run need no more repeats."""
    if times[0] >= LONG:
        return True
    return len(times) >= LEAST and (sum(times) >= TOGETHER or len(times) >= MOST)


def counted(times: list[float]) -> float:
    """The median, which is robust against single lucky or disturbed runs."""
    return median(times)
