"""Faults of time stamps against a clock of one interval: gaps, stamps that stand, steps back."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from piezoid.numerics.arrays import Array
from piezoid.statement import Statement, finding

Stamps = NDArray[np.int_]

# No more samples than this are counted as lost: a damaged stamp may lie anywhere.
_MOST = 2.0**53


@dataclass(frozen=True, kw_only=True, eq=False)
class TimeFaults:
    """Where stamps are not those of a uniform clock.

    gaps    (count,)  first sample behind missing time
    lost    (count,)  how many samples are missing in front of each of these, at least one
    stands  (count,)  samples that repeat the stamp before
    back    (count,)  first sample behind a step backwards
    stepped (count,)  by how many samples each of these steps back from where it should be
    """

    gaps: Stamps
    lost: Stamps
    stands: Stamps
    back: Stamps
    stepped: Stamps

    @classmethod
    def of(
        cls, time_s: Array, interval_s: float, excess_s: float, resolution_s: float
    ) -> "TimeFaults":
        """Find the faults of stamps.

        interval_s    of the clock
        excess_s      beyond which a step is no jitter and no rounding
        resolution_s  to which the stamps were printed
        """
        steps = np.diff(time_s)
        back = np.flatnonzero(steps < -excess_s) + 1
        gaps, lost = _gaps(time_s, interval_s, excess_s)
        return cls(
            gaps=gaps,
            lost=lost,
            stands=_stands(steps, interval_s, resolution_s),
            back=back,
            stepped=np.round(np.minimum(1.0 - steps[back - 1] / interval_s, _MOST)).astype(int),
        )

    @property
    def bridged(self) -> tuple[int, ...]:
        """Return the samples in front of which one alone is lost: a straight line fills it."""
        return tuple(self.gaps[self.lost == 1].tolist())

    @property
    def breaks(self) -> tuple[int, ...]:
        """Return the samples in front of which time is missing for longer, or goes backwards."""
        return tuple(sorted({*self.gaps[self.lost > 1].tolist(), *self.back.tolist()}))

    def statements(self, time_s: Array, place: Callable[[int], str]) -> tuple[Statement, ...]:
        """Return one statement for each kind: the count, and the first three places."""
        missing = [f"{time_s[k] - time_s[k - 1]:.6g} s" for k in self.gaps.tolist()]
        behind = [f"{time_s[k] - time_s[k - 1]:.6g} s" for k in self.back.tolist()]
        again = ["the stamp before repeated"] * len(self.stands)
        single = int(np.sum(self.lost == 1))
        bridged = f"; {single} of single samples, bridged by straight lines" if single else ""
        kinds = (
            ("gap", self.gaps, missing, int(self.lost.sum()), bridged),
            ("duplicate_time", self.stands, again, len(self.stands), ""),
            ("time_reversed", self.back, behind, int(self.stepped.sum()), ""),
        )
        return tuple(
            finding(
                quantity=kind,
                place=place(int(rows[0])),
                text=_SENTENCES[kind] + _told(rows, sizes, time_s, place) + more,
                value=float(samples),
                unit="samples",
            )
            for kind, rows, sizes, samples, more in kinds
            if len(rows)
        )


_SENTENCES = {
    "gap": "time is missing between samples",
    "duplicate_time": "the clock stands still",
    "time_reversed": "the clock goes backwards",
}


def _told(rows: Stamps, sizes: list[str], time_s: Array, place: Callable[[int], str]) -> str:
    pairs = zip(rows[:3].tolist(), sizes, strict=False)
    first = [f"{place(k)}, t = {time_s[k]:.6g} s ({size})" for k, size in pairs]
    more = f" and {len(rows) - 3} more" if len(rows) > 3 else ""
    return f" at {len(rows)} places: {'; '.join(first)}{more}"


def _gaps(time_s: Array, interval_s: float, excess_s: float) -> tuple[Stamps, Stamps]:
    """First samples after missing time: a late stamp, or a clock catching up, is no gap.

    The time lost must stay lost over the samples around the step, so the step is compared between
    stretches of stamps, not between two stamps.
    """
    candidates = np.flatnonzero(np.diff(time_s) > interval_s + excess_s) + 1
    kept, lost = [], []
    for k in candidates.tolist():
        before = _first_equal(time_s, k - 1)
        after = min(k + 1, len(time_s) - 1)
        missing_s = time_s[after] - time_s[before] - (after - before) * interval_s
        if missing_s > excess_s:
            # two losses in a row: the next one is counted at its own place
            beyond_s = time_s[k] - time_s[before] - (k - before) * interval_s
            kept.append(k)
            lost.append(max(round(min(missing_s, beyond_s, _MOST * interval_s) / interval_s), 1))
    return np.array(kept, dtype=int), np.array(lost, dtype=int)


def _first_equal(time_s: Array, k: int) -> int:
    while k > 0 and time_s[k - 1] == time_s[k]:
        k -= 1
    return k


def _stands(steps: Array, interval_s: float, resolution_s: float) -> Stamps:
    """Samples that repeat the stamp before, if more do than are printed alike by rounding."""
    alike = np.abs(steps) <= 1e-9 * interval_s
    if resolution_s <= 0.5 * interval_s:
        return np.flatnonzero(alike) + 1
    # A clock faster than its print repeats a stamp now and then, and no more often than this.
    printed_alike = len(steps) * max(0.0, 1.0 - interval_s / resolution_s)
    if np.count_nonzero(alike) > 2 * printed_alike + 2:
        return np.flatnonzero(alike) + 1
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alike.astype(int), [0]])))
    # a stamp stands for at most so many samples besides its first
    most = int(np.ceil(resolution_s / interval_s + 1e-6))
    runs = [np.arange(a, b) + 1 for a, b in edges.reshape(-1, 2).tolist() if b - a > most]
    return np.concatenate(runs) if runs else np.zeros(0, dtype=int)
