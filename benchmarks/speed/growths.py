"""Growth of stages with the number of samples, and with that of plays in a quarter of them."""

from collections.abc import Callable, Mapping, Sequence

from benchmarks.speed.drives import PLAYS
from benchmarks.speed.stopwatch import Growth, Stopwatch

DIVISORS = (16, 4, 1)  # of the number of samples
Work = Callable[[int, int], Callable[[], object]]


def growths(
    watch: Stopwatch, works: Mapping[str, Work], samples: int, plays: Sequence[int]
) -> list[Growth]:
    """Time stages at several numbers of samples and of plays.

    works  by stage: (samples, plays) -> function to time
    """
    rows = []
    for stage, work in works.items():
        lengths = {samples // divisor: work(samples // divisor, PLAYS) for divisor in DIVISORS}
        widths = {count: work(samples // 4, count) for count in plays}
        rows.append(watch.growth(stage, "samples", lengths))
        rows.append(watch.growth(stage, "plays", widths))
    return rows
