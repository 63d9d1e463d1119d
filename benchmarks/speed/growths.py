"""How stages grow: with samples, and with plays in a quarter of them."""

from collections.abc import Callable, Mapping, Sequence

from benchmarks.speed.drives import PLAYS
from benchmarks.speed.stopwatch import Growth, Stopwatch

PARTS = (16, 4, 1)  # one in so many of all samples
Work = Callable[[int, int], Callable[[], object]]


def growths(
    watch: Stopwatch, works: Mapping[str, Work], samples: int, plays: Sequence[int]
) -> list[Growth]:
    """Time stages at parts of the samples, and at numbers of plays.

    works  by stage: (samples, plays) -> what is timed
    """
    found = []
    for stage, work in works.items():
        lengths = {samples // part: work(samples // part, PLAYS) for part in PARTS}
        widths = {count: work(samples // 4, count) for count in plays}
        found.append(watch.grown(stage, "samples", lengths))
        found.append(watch.grown(stage, "plays", widths))
    return found
