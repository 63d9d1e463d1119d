"""Processor time of a piece of work, and the power of its size with which it grows."""

import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Growth:
    """How the time of one stage follows one size.

    stage   as in the table
    what    ``samples``, ``plays`` or ``recordings``
    size    what was tried, rising
    time_s  processor time at each
    """

    stage: str
    what: str
    size: tuple[int, ...]
    time_s: tuple[float, ...]

    @property
    def exponent(self) -> float:
        """Slope of log time over log size."""
        return float(np.polyfit(np.log(self.size), np.log(self.time_s), 1)[0])


def used_s() -> float:
    """Return the processor time of this process and of its children that have ended."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


@dataclass(frozen=True, kw_only=True)
class Stopwatch:
    """Takes the least of as many runs as patience allows, at least one."""

    patience_s: float = 0.3

    def cpu_s(self, work: Callable[[], object]) -> float:
        """Return the least processor time of a few runs."""
        least_s, spent_s = np.inf, 0.0
        while True:
            begun_s, runs, took_s = used_s(), 0, 0.0
            while took_s <= 0.0:  # the clock may tick more slowly than the work is done
                work()
                runs, took_s = runs + 1, used_s() - begun_s
            least_s, spent_s = min(least_s, took_s / runs), spent_s + took_s
            if spent_s >= self.patience_s:
                return float(least_s)

    def grown(self, stage: str, what: str, works: Mapping[int, Callable[[], object]]) -> Growth:
        """Time one stage at several sizes."""
        times = tuple(self.cpu_s(work) for work in works.values())
        return Growth(stage=stage, what=what, size=tuple(works), time_s=times)
