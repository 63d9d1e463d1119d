"""SampleRows: rows of a table that become samples, and where one between two is missing."""

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.records.table import RawTable

Rows = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleRows:
    """Rows in the order of their samples.

    kept     (rows,)     of the table: whole ones
    place    (samples,)  number among ``kept``; a half lies between two rows, where one is lost
    breaks   first sample after each break, increasing
    bridged  samples that lie between two rows
    """

    kept: Rows
    place: Array
    breaks: tuple[int, ...]
    bridged: tuple[int, ...]

    @classmethod
    def of(cls, kept: Rows, breaks: Collection[int], lost: Collection[int]) -> "SampleRows":
        """Return all kept rows, with one more sample in front of some.

        breaks  kept rows, by number, before which memory ends
        lost    kept rows in front of which one sample alone is missing; not where a break is
        """
        filled = np.array(sorted(set(lost) - set(breaks)), dtype=int)
        at = np.array(sorted(breaks), dtype=int)
        return cls(
            kept=kept,
            place=np.insert(np.arange(len(kept), dtype=np.float64), filled, filled - 0.5),
            breaks=tuple((at + np.searchsorted(filled, at)).tolist()),
            bridged=tuple((filled + np.arange(len(filled))).tolist()),
        )

    def cut(self, part: slice) -> "SampleRows":
        """Return a part of the samples."""
        first, last = part.start, part.stop
        return replace(
            self,
            place=self.place[part],
            breaks=tuple(b - first for b in self.breaks if first < b < last),
            bridged=tuple(b - first for b in self.bridged if first <= b < last),
        )

    def told(self, table: RawTable) -> Callable[[int], str]:
        """Return how messages call a sample: the place of its row, or of the one in front."""
        return lambda sample: table.place_of_row(int(self.kept[int(self.place[sample])]))

    def values(self, column: Array) -> Array:
        """Return a column's samples, straight between two rows where one is lost."""
        return np.asarray(np.interp(self.place, np.arange(len(self.kept)), column[self.kept]))
