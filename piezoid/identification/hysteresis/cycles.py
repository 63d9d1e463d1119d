"""Slow trends over many equal cycles: gain, middle, and both reversals.

    y_i = g_i c + z_i,     c the mean cycle,     trends of g_i, z_i and the tips by Theil and Sen

One fit over all cycles averages what goes on slowly; one number a cycle shows it far below the
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

FEWEST = 8  # cycles: a trend of fewer may be one cycle that was odd
MOST = 1000  # that are compared: each with each
SURE = 1e-3  # false alarm probability of a trend, of four trends
GAIN = 2e-4  # smaller changes over all cycles do not matter to a controller
TIP = 0.02  # of the samples of a cycle at either end of the drive
SLIDES = 0.1  # samples over all cycles: less is how a period that is no whole number is cut
MOST_WITH_SLIDES = 50  # score, as for a lag that cannot be separated from loop width
WANDERS = 3.0  # times the scatter of a tip by the noise of its samples


@dataclass(frozen=True, kw_only=True, eq=False)
class Cycles:
    """The equal cycles of a piece, samples between two taken straight.

    name              of the recording
    sampling_rate_Hz  > 0
    drive, response   (cycles, samples)  scaled
    period_samples    of one cycle, any number
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
        """How many there are."""
        return len(self.drive)

    @property
    def _some(self) -> slice:
        return slice(None, None, max(1, self.count // MOST))

    def trend(self, values: Array) -> Trend | None:
        """Return the trend of one number a cycle, (cycles,), for each cycle."""
        return trend_of(np.arange(self.count, dtype=np.float64)[self._some], values[self._some])

    def scatter(self, values: Array, trend: Trend) -> float:
        """Return how far numbers scatter about their trend."""
        return spread_of((values - trend.slope * np.arange(self.count))[self._some]).sigma

    @cached_property
    def gain(self) -> Trend | None:
        """Relative trend of the sensitivity per cycle; None if it is not significant."""
        mean = self.response.mean(axis=0) - self.response.mean()
        centred = self.response - self.response.mean(axis=1)[:, None]
        trend = self.trend(centred @ mean / (mean @ mean))
        if trend is None or trend.p_value > SURE or abs(trend.slope) * (self.count - 1) < GAIN:
            return None
        return trend

    @cached_property
    def slide(self) -> Trend | None:
        """By how many samples a cycle the displacement slides against its drive, or None.

        - P / (2 pi) arg(Y_i / U_i),     first harmonics of cycle i and its period P
        """
        turn = np.arange(self.drive.shape[1]) / self.period_samples
        wave = np.exp(-2j * np.pi * turn)
        phase = np.unwrap(np.angle((self.response @ wave) / (self.drive @ wave)))
        lag = -phase * self.period_samples / (2.0 * np.pi)
        trend = self.trend(lag)
        if trend is None or trend.p_value > SURE:
            return None
        change = abs(trend.slope) * (self.count - 1)
        return trend if change >= max(SLIDES, WANDERS * self.scatter(lag, trend)) else None


def cycles_of(piece: Piece) -> Cycles | None:
    """Return the equal cycles of a piece; None if they are too few to show a trend."""
    drive, response = piece.fitted_drive, piece.fitted_response
    cycles = equal_cycles(drive, fewest=FEWEST) if np.ptp(drive) > 0.0 else None
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
    """Return one sentence for everything that goes on slowly over equal cycles, but slides.

    stroke_m  what the number 1 of the response means
    noise     white, of a sample, scaled units
    """
    around = cycles.drive.mean(axis=0)
    width = max(int(TIP * len(around)), 1)
    noise_m = noise * stroke_m / width**0.5
    order = np.argsort(around, kind="stable")
    sentences = []
    if cycles.gain is not None:
        ends = (cycles.gain.slope, *cycles.gain.ci95)
        change, low, high = (100 * end * (cycles.count - 1) for end in ends)
        sentences.append(
            f"{cycles.name}: cycle by cycle the sensitivity goes by {change:+.3g} % over "
            f"{cycles.count} equal cycles (95 %: {low:.3g} to {high:.3g} %)."
        )
    for tip, where in (("upper", order[-width:]), ("lower", order[:width])):
        level_m = stroke_m * cycles.response[:, where].mean(axis=1)
        trend = cycles.trend(level_m)
        if trend is None:
            continue
        change_m = trend.slope * (cycles.count - 1)
        # the first cycles may still forget what came before them: no scatter of the others
        scatter_m = cycles.scatter(level_m, trend)
        parts = []
        if trend.p_value < SURE and abs(change_m) > WANDERS * noise_m:
            parts.append(f"goes by {with_unit(change_m, 'm')}")
        if scatter_m > WANDERS * noise_m:
            parts.append(
                f"wanders by {with_unit(scatter_m, 'm')} rms about its trend, where the noise of "
                f"its samples is {with_unit(noise_m, 'm')}"
            )
        if parts:
            sentences.append(
                f"{cycles.name}: over {cycles.count} equal cycles the {tip} tip "
                f"{' and '.join(parts)}."
            )
    return tuple(sentences)


def limits_of_cycles(cycles: Sequence[Cycles]) -> tuple[Limit, ...]:
    """Return limits for displacement that slides against its drive from cycle to cycle."""
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
            "the time): two clocks, it seems, or a lag or a loop that changes; no one lag or "
            "width holds"
        )
        limits.append(Limit(lack="slides", reason=reason, most=MOST_WITH_SLIDES))
    return tuple(limits)
