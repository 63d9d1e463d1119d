"""A stream thinned to what the rows of a search need of it, without an approximation.

Between two rows plays are told by the extremes that were not wiped out; around what a row is
answered from, and as long before as filters remember, every sample is kept. A pass over it takes
as long for a year as for a minute.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.hysteresis.rows import QUICK
from piezoid.identification.streamed.stream import SETTLED, Stream
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Samples
from piezoid.operators.play import LastingExtremes

WORTH = 4  # times as many samples as are kept: else the stream itself is passed over
ROOM = 4  # samples by which the lag may move from a neighbour on the grid of lags


@dataclass(frozen=True, kw_only=True, eq=False)
class Thinned:
    """What is left of one stream.

    drive     (kept,)  extremes and whole stretches, in their order
    sample    (rows,)  number in the stream of every row
    place     (rows,)  where that sample would stand in ``drive``, counted on from the stretch
              around its source
    response  (rows,)  what was measured there
    """

    drive: Array
    sample: Samples
    place: Samples
    response: Array

    def source(self, late: int) -> Samples:
        """Return where in ``drive`` every row has its source, so many samples before it."""
        return self.place + np.maximum(self.sample - late, 0) - self.sample


@dataclass(frozen=True, kw_only=True)
class Window:
    """What is kept of every row.

    first   samples before the row at which its stretch begins
    behind  samples before the row behind which it ends
    """

    first: int
    behind: int


def window_of(rig: Rig, rate_Hz: float, lag_s: tuple[float, float]) -> Window:
    """Return what is kept of every row, for lags in these limits."""
    time_s = 0.0 if rig.sensor_bandwidth_Hz is None else 1 / (2 * np.pi * rig.sensor_bandwidth_Hz)
    quick = time_s * rate_Hz < QUICK  # then the filter is a part of the delay
    early, late = (end_s * rate_Hz + (time_s * rate_Hz if quick else 0.0) for end_s in lag_s)
    lead = 0 if quick else int(np.ceil(SETTLED * time_s * rate_Hz))
    # One more at either end: which sample a lag falls on is told to rounding.
    return Window(first=int(np.floor(late)) + 2 + lead, behind=max(int(np.floor(early)) - 1, 0))


def worth_thinning(windows: Sequence[Window], stride: int) -> bool:
    """Tell whether so much less is kept than there is that it is worth the pass."""
    return all(stride >= WORTH * (one.first - one.behind + 1) for one in windows)


def thinned(stream: Stream, stride: int, window: Window) -> Thinned:
    """Pass once over a stream and keep what every ``stride``-th of its rows needs."""
    sample = np.arange(0, stream.samples, stride)
    begins = np.maximum(sample - window.first, 0)
    ends = np.maximum(sample - window.behind, 0) + 1
    place, response = np.empty(len(sample), dtype=int), np.empty(len(sample))
    kept = LastingExtremes()
    first = now = answered = 0
    for drive, measured in stream.chunks():
        end, done = first + len(drive), first
        while now < len(sample) and begins[now] < end:
            begin = max(int(begins[now]), done)
            kept.follow(drive[done - first : begin - first])
            if begin == begins[now]:
                place[now] = kept.count + int(sample[now] - begin)
            done = max(min(int(ends[now]), end), begin)
            kept.keep(drive[begin - first : done - first])
            if ends[now] > end:
                break
            now += 1
        kept.follow(drive[done - first :])
        here = np.searchsorted(sample, end)
        response[answered:here] = measured[sample[answered:here] - first]
        first, answered = end, int(here)
    return Thinned(drive=kept.values, sample=sample, place=place, response=response)


def lags_beside(lag_s: float, tried_s: Sequence[float], rate_Hz: float) -> tuple[float, float]:
    """Return the limits of a search for the lag about the best of those that were tried."""
    place = tried_s.index(lag_s)
    room_s = ROOM / rate_Hz
    low_s = tried_s[max(place - 1, 0)] - room_s
    high_s = tried_s[min(place + 1, len(tried_s) - 1)] + room_s
    return max(low_s, 0.0), high_s
