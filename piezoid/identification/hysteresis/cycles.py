"""Slow trends over many equal cycles, found cycle by cycle: gain, middle, and the two tips.

    y_i = g_i c + z_i,     c the mean cycle,     trends of g_i, z_i and the tips by Theil and Sen

One fit over all cycles averages what goes on slowly; one number a cycle shows it far below the
noise of a sample.
"""

import numpy as np

from piezoid.identification.dynamics.repetition import equal_cycles
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import Trend, spread_of, trend_of
from piezoid.readable import told

FEWEST = 8  # cycles: a trend of fewer may be one cycle that was odd
MOST = 1000  # that are compared: each with each
SURE = 1e-3  # chance of such a trend where there is none, of four that are asked for
GAIN = 2e-4  # a smaller change over all cycles means nothing to a controller
TIP = 0.02  # of the samples of a cycle at either end of the drive
SLIDES = 0.1  # samples over all cycles: less is how a period that is no whole number is cut
WANDERS = 3.0  # times what the noise of its samples lets a tip scatter by


def trends_over_cycles(piece: Piece, stroke_m: float, noise: float) -> tuple[str, ...]:
    """Return one sentence for everything that goes on slowly over a piece's equal cycles.

    stroke_m  what the number 1 of the response means
    noise     white, of a sample, scaled units
    """
    found = _cycles(piece)
    if found is None:
        return ()
    drives, cycles, _ = found
    around = drives.mean(axis=0)
    count, period = cycles.shape
    width = max(int(TIP * period), 1)
    order = np.argsort(around, kind="stable")
    tips = {"upper": order[-width:], "lower": order[:width]}
    place = np.arange(count, dtype=np.float64)
    some = slice(None, None, max(1, count // MOST))
    said = _gain(piece.name, _gain_trend(cycles), count)
    for name, where in tips.items():
        tip = cycles[:, where].mean(axis=1)
        said += _tip(
            piece.name, name, place[some], tip[some], (stroke_m, noise / width**0.5), count
        )
    return tuple(said)


def slide_over_cycles(piece: Piece) -> str:
    """Return a sentence on a displacement that slides against its drive in time, or an empty text.

        arg(Y_i / U_i),     first harmonics of cycle i

    Half a sentence, without what it may be at another speed.
    """
    found = _cycles(piece)
    if found is None:
        return ""
    drives, cycles, period = found
    wave = np.exp(-2j * np.pi * np.arange(cycles.shape[1]) / period)
    phase = np.unwrap(np.angle((cycles @ wave) / (drives @ wave)))
    late = -phase * period / (2.0 * np.pi)  # samples
    count = len(late)
    some = slice(None, None, max(1, count // MOST))
    place = np.arange(count, dtype=np.float64)[some]
    trend = trend_of(place, late[some])
    change = 0.0 if trend is None else trend.slope * (count - 1)
    if trend is None or trend.p_value > SURE or abs(change) < SLIDES:
        return ""
    scatter = spread_of(late[some] - trend.slope * place).sigma
    if abs(change) < WANDERS * scatter:
        return ""
    slides_s = abs(change) / piece.sampling_rate_Hz
    way = "later" if change > 0.0 else "earlier"
    return (
        f"{piece.name}: cycle by cycle the displacement comes {way} behind its drive, by "
        f"{told(slides_s, 's')} over {count} equal cycles ({1e6 * trend.slope / period:+.3g} ppm "
        "of the time): two clocks, it seems, or a lag or a loop that changes; no one lag or width "
        "holds"
    )


def _cycles(piece: Piece) -> tuple[Array, Array, float] | None:
    """Return drive and response by equal cycles, (count, samples) each, and the period."""
    rows = slice(piece.first, piece.last)
    drive, response = piece.drive[rows], piece.response[rows]
    found = equal_cycles(drive, fewest=FEWEST) if np.ptp(drive) > 0.0 else None
    if found is None:
        return None
    return found.cut(drive), found.cut(response), float(found.period_samples)


def gain_goes(piece: Piece) -> bool:
    """Tell whether the sensitivity of a piece goes slowly over its equal cycles."""
    found = _cycles(piece)
    return found is not None and _gain_trend(found[1]) is not None


def _gain_trend(cycles: Array) -> Trend | None:
    """Return how the sensitivity goes from cycle to cycle, None where it does not."""
    mean = cycles.mean(axis=0) - cycles.mean()
    gain = (cycles - cycles.mean(axis=1)[:, None]) @ mean / (mean @ mean)
    some = slice(None, None, max(1, len(gain) // MOST))
    trend = trend_of(np.arange(len(gain), dtype=np.float64)[some], gain[some])
    if trend is None or trend.p_value > SURE or abs(trend.slope) * (len(gain) - 1) < GAIN:
        return None
    return trend


def _gain(name: str, trend: Trend | None, count: int) -> list[str]:
    if trend is None:
        return []
    change, low, high = (end * (count - 1) for end in (trend.slope, *trend.ci95))
    return [
        f"{name}: cycle by cycle the sensitivity goes by {100 * change:+.3g} % over {count} equal "
        f"cycles (95 %: {100 * low:.3g} to {100 * high:.3g} %)."
    ]


def _tip(
    name: str, tip: str, place: Array, level: Array, scale: tuple[float, float], count: int
) -> list[str]:
    stroke_m, noise = scale
    trend = trend_of(place, level)
    if trend is None:
        return []
    change = trend.slope * (count - 1)
    # the first cycles may still forget what came before them: no scatter of the others
    scatter = spread_of(level - trend.slope * place).sigma
    goes = trend.p_value < SURE and abs(change) > WANDERS * noise
    wanders = scatter > WANDERS * noise
    if not (goes or wanders):
        return []
    parts = [f"goes by {told(change * stroke_m, 'm')}"] if goes else []
    parts += [
        f"wanders by {told(scatter * stroke_m, 'm')} rms about its trend, where the noise of its "
        f"samples is {told(noise * stroke_m, 'm')}"
    ] * wanders
    return [f"{name}: over {count} equal cycles the {tip} tip {' and '.join(parts)}."]
