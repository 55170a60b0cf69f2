"""How often a run is repeated, and which of its times counts: for all programs alike."""

from statistics import median

# Seconds. A run this long is not repeated; shorter ones at least so many times in all, and more often while they have taken less than a
# fifth of a second together.
LONG, LEAST, MOST, TOGETHER = 0.5, 5, 20, 0.2


def enough(times: list[float]) -> bool:
    """Whether these times of one run need no more repeats."""
    if times[0] >= LONG:
        return True
    return len(times) >= LEAST and (sum(times) >= TOGETHER or len(times) >= MOST)


def counted(times: list[float]) -> float:
    """The time that counts: the median, which neither one lucky nor one disturbed run moves."""
    return median(times)
