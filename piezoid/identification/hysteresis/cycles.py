"""Slow trends over many equal cycles: sensitivity, lag, and displacement at both reversals.

    y_i = g_i c + z_i,     c the mean cycle,     trends of g_i, the lag and the tips by Theil and
    Sen

One fit over all cycles averages slow changes. One value per cycle shows changes far below the
noise of a sample.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.quality import Limit
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.repetition import equal_cycles
from piezoid.numerics.robust import Trend, spread_of, trend_of

MIN_CYCLES = 8  # a trend of fewer cycles may be a single unusual cycle
MAX_CYCLES = 1000  # compared pair by pair
MAX_P_VALUE = 1e-3  # false-alarm probability of each of the four trends
MIN_GAIN_CHANGE = 2e-4  # smaller changes over all cycles do not matter to a controller
TIP_SHARE = 0.02  # of the samples of a cycle, at either end of the drive
MIN_SLIDE_SAMPLES = 0.1  # over all cycles: rounding of a non-integer period causes less
MAX_SCORE_WITH_SLIDE = 50  # as for a lag that cannot be separated from loop width
MIN_SIGNIFICANCE = 3.0  # change over its scatter, or scatter of a tip over its noise


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycles:
    """The equal cycles of a piece, linearly interpolated between its samples.

    name              of the recording
    sampling_rate_Hz  > 0
    drive, response   (cycles, samples)  scaled
    period_samples    of one cycle, not necessarily an integer
    """

    name: str
    sampling_rate_Hz: float
    drive: Array
    response: Array
    period_samples: float

    def __post_init__(self) -> None:
        freeze(self, "drive", "response", ndim=2)

    @property
    def count(self) -> int:
        """Number of cycles."""
        return len(self.drive)

    def trend(self, values: Array) -> Trend | None:
        """Return the trend per cycle of values with one entry per cycle, (cycles,)."""
        every = max(1, self.count // MAX_CYCLES)
        return trend_of(np.arange(self.count, dtype=np.float64)[::every], values[::every])

    def scatter(self, values: Array, trend: Trend) -> float:
        """Return the standard deviation of values, (cycles,), about their trend."""
        every = max(1, self.count // MAX_CYCLES)
        return spread_of((values - trend.slope * np.arange(self.count))[::every]).sigma

    @cached_property
    def gain(self) -> Trend | None:
        """Relative trend of the sensitivity per cycle; None if it is not significant."""
        mean = self.response.mean(axis=0) - self.response.mean()
        centred = self.response - self.response.mean(axis=1)[:, None]
        trend = self.trend(centred @ mean / (mean @ mean))
        if trend is None or trend.p_value > MAX_P_VALUE:
            return None
        return None if abs(trend.slope) * (self.count - 1) < MIN_GAIN_CHANGE else trend

    @cached_property
    def slide(self) -> Trend | None:
        """Trend of the lag behind the drive, samples per cycle; None if it is not significant.

        - P / (2 pi) arg(Y_i / U_i),     first harmonics of cycle i and its period P
        """
        turn = np.arange(self.drive.shape[1]) / self.period_samples
        wave = np.exp(-2j * np.pi * turn)
        phase = np.unwrap(np.angle((self.response @ wave) / (self.drive @ wave)))
        lag = -phase * self.period_samples / (2.0 * np.pi)
        trend = self.trend(lag)
        if trend is None or trend.p_value > MAX_P_VALUE:
            return None
        least_change = max(MIN_SLIDE_SAMPLES, MIN_SIGNIFICANCE * self.scatter(lag, trend))
        return trend if abs(trend.slope) * (self.count - 1) >= least_change else None


def cycles_of(piece: Piece) -> Cycles | None:
    """Return the equal cycles of a piece; None if there are too few for a trend."""
    drive, response = piece.fitted_drive, piece.fitted_response
    cycles = equal_cycles(drive, fewest=MIN_CYCLES) if np.ptp(drive) > 0.0 else None
    if cycles is None:
        return None
    return Cycles(
        name=piece.name,
        sampling_rate_Hz=piece.sampling_rate_Hz,
        drive=cycles.cut(drive),
        response=cycles.cut(response),
        period_samples=float(cycles.period_samples),
    )


def trends_over_cycles(cycles: Cycles, stroke_m: float, noise: float) -> tuple[str, ...]:
    """Return a sentence for each significant trend of the sensitivity and of both tips.

    stroke_m  displacement of one scaled unit
    noise     rms of the white noise of a sample, scaled units
    """
    mean_drive = cycles.drive.mean(axis=0)
    width = max(int(TIP_SHARE * len(mean_drive)), 1)
    noise_m = noise * stroke_m / width**0.5
    order = np.argsort(mean_drive, kind="stable")
    sentences = []
    if cycles.gain is not None:
        slopes = (cycles.gain.slope, *cycles.gain.ci95)
        change, low, high = (100 * slope * (cycles.count - 1) for slope in slopes)
        sentences.append(
            f"{cycles.name}: cycle by cycle the sensitivity changes by {change:+.3g} % over "
            f"{cycles.count} equal cycles (95 %: {low:.3g} to {high:.3g} %)."
        )
    for tip, samples in (("upper", order[-width:]), ("lower", order[:width])):
        level_m = stroke_m * cycles.response[:, samples].mean(axis=1)
        trend = cycles.trend(level_m)
        if trend is None:
            continue
        change_m = trend.slope * (cycles.count - 1)
        # A robust scatter: the first cycles may still depend on the initial state.
        scatter_m = cycles.scatter(level_m, trend)
        changes = []
        if trend.p_value < MAX_P_VALUE and abs(change_m) > MIN_SIGNIFICANCE * noise_m:
            changes.append(f"moves by {with_unit(change_m, 'm')}")
        if scatter_m > MIN_SIGNIFICANCE * noise_m:
            changes.append(
                f"wanders by {with_unit(scatter_m, 'm')} rms about its trend (noise of the mean "
                f"of its samples: {with_unit(noise_m, 'm')})"
            )
        if changes:
            sentences.append(
                f"{cycles.name}: over {cycles.count} equal cycles the {tip} tip "
                f"{' and '.join(changes)}."
            )
    return tuple(sentences)


def limits_of_cycles(cycles: Sequence[Cycles]) -> tuple[Limit, ...]:
    """Return a limit for each piece whose lag between drive and displacement has a trend."""
    limits = []
    for recorded in cycles:
        trend = recorded.slide
        if trend is None:
            continue
        slides_s = abs(trend.slope) * (recorded.count - 1) / recorded.sampling_rate_Hz
        direction = "falls behind" if trend.slope > 0.0 else "gains on"
        ppm = 1e6 * trend.slope / recorded.period_samples
        reason = (
            f"{recorded.name}: cycle by cycle the displacement {direction} its drive, by "
            f"{with_unit(slides_s, 's')} over {recorded.count} equal cycles ({ppm:+.3g} ppm of "
            "the time): two clocks, or a lag or loop width that changes; no single lag or width "
            "describes them"
        )
        limits.append(Limit(lack="slides", reason=reason, most=MAX_SCORE_WITH_SLIDE))
    return tuple(limits)
