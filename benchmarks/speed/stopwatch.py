"""Processor time of a function, and its growth with a size."""

import resource
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, kw_only=True)
class Growth:
    """Processor time of one stage against one size.

    stage     as in the table
    quantity  ``samples`` or ``plays``
    size      increasing values of the quantity
    time_s    processor time at each size
    """

    stage: str
    quantity: str
    size: tuple[int, ...]
    time_s: tuple[float, ...]

    @property
    def exponent(self) -> float:
        """Slope of log time over log size."""
        return float(np.polyfit(np.log(self.size), np.log(self.time_s), 1)[0])


def used_s() -> float:
    """Return the processor time of this process and of its terminated children."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def peak_megabytes() -> float:
    """Return the peak memory of this process."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


@dataclass(frozen=True, kw_only=True)
class Stopwatch:
    """Repeats a function for ``patience_s`` and takes the shortest time."""

    patience_s: float = 0.3

    def cpu_s(self, work: Callable[[], object]) -> float:
        """Return the shortest processor time of several runs."""
        shortest_s, total_s = np.inf, 0.0
        while True:
            start_s, runs, elapsed_s = used_s(), 0, 0.0
            while elapsed_s <= 0.0:  # the function may be faster than the resolution of the clock
                work()
                runs, elapsed_s = runs + 1, used_s() - start_s
            shortest_s, total_s = min(shortest_s, elapsed_s / runs), total_s + elapsed_s
            if total_s >= self.patience_s:
                return float(shortest_s)

    def growth(
        self, stage: str, quantity: str, works: Mapping[int, Callable[[], object]]
    ) -> Growth:
        """Time one stage at several sizes."""
        times = tuple(self.cpu_s(work) for work in works.values())
        return Growth(stage=stage, quantity=quantity, size=tuple(works), time_s=times)
