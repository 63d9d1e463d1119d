"""Applicability of the Modified Prandtl-Ishlinskii class to the data.

Three ways it does not, each told apart before a number is believed:
a loop whose opening changes sign (the operator's branches never cross), a response that turns
back while the drive goes on (no branch of an invertible operator does), and a wide loop that a
lag alone explains (a play sum imitates lag, with weights that hold at no other rate).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.lag_rivals import EXPLAINED, no_lag
from piezoid.identification.hysteresis.order import Choice, attempt
from piezoid.identification.hysteresis.pieces import Piece, Scales, widest_swing
from piezoid.identification.hysteresis.search import Settings
from piezoid.numerics.arrays import Array, freeze
from piezoid.numerics.noise import white_noise_rms
from piezoid.records.constant_drive import answers
from piezoid.records.reversals import noise_of, reversals_of

WIDE = 0.01  # of the displacement range: a loop worth explaining
CROSSING = 0.15  # of the widest opening: how far a loop may open the wrong way
BINS = 20  # of the drive, in each of which the branches are averaged
BUTTERFLY = 0.25  # of the displacement range: distance of both ends from an extremum between them
BEYOND = 0.1  # of a drive's range at either end: less is driven over the same range
TURNING = 0.05  # of the displacement range: how far a branch may turn back
UNEXPLAINED = 0.08  # of the displacement range: held-out rms of an unusable fit
FOLLOWED = 0.7  # of the rms of the motion: largest residual, half of the power explained
POINTS = 41  # of the grid on which a loop's branches are compared
MAX_JUMP = 0.2  # of a branch, between two samples: a parabola's chord is off by its square, 4 %
AS_GOOD = 1.1  # held-out error of the lag alone over that of the hysteresis model


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The opening of one loop: falling branch minus rising branch at the same drive.

    drive     (points,)  inside the span that both branches share
    opening   (points,)  positive where the displacement lags the drive
    rise      (points,)  the rising branch
    span      drive range of the loop
    """

    drive: Array
    opening: Array
    rise: Array
    span: float

    def __post_init__(self) -> None:
        freeze(self, "drive", "opening", "rise")


def loops_of(drive: Array, response: Array, noise: float) -> tuple[Loop, ...]:
    """Return the loops made by successive rising and falling branches of nearly equal span.

    A branch that the drive jumped over was never recorded, and makes no loop.

    drive, response  (samples,)
    noise            excursions of the drive that make no reversal
    """
    turns = np.array(reversals_of(drive, noise), dtype=int)
    loops = []
    for a, b, c in zip(turns[:-2], turns[1:-1], turns[2:], strict=True):
        first, second = drive[b] - drive[a], drive[c] - drive[b]
        if abs(first + second) > 0.15 * abs(first):
            continue
        branches = slice(a, b + 1), slice(b, c + 1)
        rising, falling = branches if first > 0 else branches[::-1]
        jumps = [float(np.diff(np.sort(drive[branch])).max()) for branch in branches]
        if max(jumps) > MAX_JUMP * abs(first):
            continue
        low = max(drive[rising].min(), drive[falling].min())
        high = min(drive[rising].max(), drive[falling].max())
        grid = np.linspace(low, high, POINTS + 2)[1:-1]
        up = _branch_on_grid(grid, drive[rising], response[rising])
        down = _branch_on_grid(grid, drive[falling], response[falling])
        loops.append(Loop(drive=grid, opening=down - up, rise=up, span=float(high - low)))
    return tuple(loops)


def _branch_on_grid(grid: Array, drive: Array, response: Array) -> Array:
    """Return a branch on a grid of the drive: the mean of the samples around each point."""
    order = np.argsort(drive, kind="stable")
    edges = np.concatenate([[-np.inf], (grid[1:] + grid[:-1]) / 2, [np.inf]])
    first = np.searchsorted(drive[order], edges)
    first[0], first[-1] = np.searchsorted(
        drive[order], [1.5 * grid[0] - 0.5 * grid[1], 1.5 * grid[-1] - 0.5 * grid[-2]]
    )
    sums = np.concatenate([[0.0], np.cumsum(response[order])])
    count = np.diff(first)
    mean = np.diff(sums[first]) / np.maximum(count, 1)
    interpolated = np.interp(grid, drive[order], response[order])
    return np.asarray(np.where(count > 2, mean, interpolated))


def _loops(piece: Piece) -> tuple[Loop, ...]:
    rows = slice(piece.first, piece.last)
    drive = piece.drive[rows]
    return loops_of(drive, piece.response[rows], max(noise_of(drive), 0.02))


def reason_in_loops(pieces: Sequence[Piece]) -> str:
    """Return the reason in the recorded loops why the class does not apply, or ''.

    A material contradicts the class wherever it is driven over its range. What as many recordings
    over the same range do not show is their own: a fast one's slew limit or long lag. So is a
    branch that turns back or a loop that opens the wrong way in less than half of the recordings
    with loops: a clock that slipped, an initial state, creep between levels.
    """
    butterfly = _of_material(pieces, [_butterfly(piece) for piece in pieces])
    if butterfly:
        return butterfly
    looped, reasons = [], []
    for piece in pieces:
        loops = [loop for loop in _loops(piece) if loop.span > 0.4]
        if loops:
            looped.append(piece)
            height = float(np.ptp(piece.response[piece.first : piece.last]))
            noise = white_noise_rms(piece.response)
            reasons.append(_turning(loops, height, noise) or _crossing(loops, height, noise))
    if 2 * sum(map(bool, reasons)) < len(looped):
        return ""
    return _of_material(looped, reasons)


def _of_material(pieces: Sequence[Piece], reasons: Sequence[str]) -> str:
    """Return the first reason that most recordings over the same range have; empty: none.

    reasons  (pieces)  empty where there is none
    """
    drives = [piece.drive[piece.first : piece.last] for piece in pieces]
    ranges = [(float(drive.min()), float(drive.max())) for drive in drives]
    for piece, (low, high), reason in zip(pieces, ranges, reasons, strict=True):
        margin = BEYOND * (high - low)
        agreeing = [
            bool(text)
            for text, (lowest, highest) in zip(reasons, ranges, strict=True)
            if lowest <= low + margin and highest >= high - margin
        ]
        if reason and 2 * sum(agreeing) > len(agreeing):
            return f"{piece.name}: {reason}"
    return ""


def _butterfly(piece: Piece) -> str:
    """Describe an extremum of the mean displacement inside the drive range, or return ''."""
    rows = slice(piece.first, piece.last)
    drive, response = piece.drive[rows], piece.response[rows]
    edges = np.linspace(drive.min(), drive.max(), BINS + 1)
    bins = np.searchsorted(edges[1:-1], drive)
    count = np.bincount(bins, minlength=BINS)
    if np.ptp(drive) < 0.4 or not count.all():
        return ""
    mean = np.bincount(bins, response, BINS) / count
    height = float(np.ptp(response))
    for curve, extreme in ((mean, "minimum"), (-mean, "maximum")):
        low_end, right = float(curve[0] - curve.min()), float(curve[-1] - curve.min())
        if min(low_end, right) > BUTTERFLY * height:
            return (
                f"the loop reverses its sign (a butterfly): the displacement has its {extreme} "
                f"inside the range of the drive, {100 * low_end / height:.0f} % and "
                f"{100 * right / height:.0f} % of its range away from its values at the two ends. "
                "A ceramic driven beyond its coercive field, an electrostrictor and a reading "
                "without its sign do this; a sum of plays rises with the drive throughout"
            )
    return ""


def _turning(loops: Sequence[Loop], height: float, noise: float) -> str:
    rise, doubt = _typical([loop.rise - loop.rise.mean() for loop in loops])
    drop = float((np.maximum.accumulate(rise) - rise).max())
    if drop <= TURNING * height + 6 * noise + 3 * doubt:
        return ""
    return (
        f"the displacement turns back by {100 * drop / height:.1f} % of its range while the drive "
        "goes on rising; no branch of this operator does that"
    )


def _crossing(loops: Sequence[Loop], height: float, noise: float) -> str:
    opening, doubt = _typical([loop.opening for loop in loops])
    wrong, widest = float(-opening.min()), float(np.abs(opening).max())
    if wrong <= max(CROSSING * widest, 8 * noise, 3 * doubt) or widest <= WIDE * height / 2:
        return ""
    return (
        f"the loop opens the wrong way by {100 * wrong / height:.2f} % of the range (widest "
        f"opening {100 * widest / height:.2f} %): the displacement leads the drive over part of "
        "the loop, as no sum of plays can"
    )


def _typical(curves: Sequence[Array]) -> tuple[Array, float]:
    """Return the median curve and how far the curves scatter about it, as a standard error."""
    median = np.median(curves, axis=0)
    scatter = float(np.sqrt(np.mean((np.array(curves) - median) ** 2)))
    return np.asarray(median), scatter / float(np.sqrt(len(curves)))


def widest_opening(pieces: Sequence[Piece]) -> float:
    """Return how far the widest loop opens, scaled units."""
    return max((float(loop.opening.max()) for p in pieces for loop in _loops(p)), default=0.0)


def reason_of_lag(
    pieces: Sequence[Piece],
    choice: Choice,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
) -> str:
    """Return that a lag alone does as well as the best fit of a wide loop, or an empty text.

    A lag that leaves much of what no lag leaves is none, however little the hysteresis does: a
    wrong cable, two clocks, a slip or another machine's motion are followed by neither.
    """
    widest = widest_opening(pieces)
    height = max(float(np.ptp(p.response[p.first : p.last])) for p in pieces)
    if widest < WIDE * height:
        return ""
    progress("a lag alone, without hysteresis")
    zones = min(choice.best.shape.below, 2)
    none = no_lag(pieces, settings.longest_lag_s).held_out_rms
    within = min(AS_GOOD * choice.best.held_out_rms, EXPLAINED * none)
    for lag in ("first_order", "delay"):
        shape = Shape(plays=0, below=zones, above=zones, lag=lag)
        trial = attempt(pieces, shape, replace(settings, lag_s=None), within=within)
        if trial is not None:
            return (
                f"a {lag.replace('_', '-')} lag of {with_unit(trial.lag_s, 's')} without any "
                f"hysteresis leaves {100 * trial.held_out_rms / height:.3g} % of the displacement "
                "range on held-out data, the hysteresis model "
                f"{100 * choice.best.held_out_rms / height:.3g} %: the loop "
                f"({100 * widest / height:.1f} % wide) is phase lag, not hysteresis"
            )
    return ""


def reason_of_error(pieces: Sequence[Piece], choice: Choice) -> str:
    """State that the error of the best fit is too large to be used, or return ''."""
    height = max(float(np.ptp(p.response[p.first : p.last])) for p in pieces)
    share = choice.best.held_out_rms / height
    if share <= UNEXPLAINED:
        return ""
    return (
        f"the best fit leaves {100 * share:.1f} % of the displacement range on held-out data; "
        "plays, dead zones and a lag are not what this response is made of"
    )


def reason_of_no_answer(pieces: Sequence[Piece], choice: Choice, scales: Scales) -> str:
    """State that the displacement does not follow its drive, or return an empty text."""
    responses = [p.response[p.first : p.last] for p in pieces]
    motion_rms = float(np.sqrt(np.mean(np.concatenate([(y - y.mean()) ** 2 for y in responses]))))
    residual_rms = choice.best.held_out_rms
    if residual_rms <= FOLLOWED * motion_rms or any(_follows(piece) for piece in pieces):
        return ""
    stroke_m = abs(scales.displacement_m)
    low, high = widest_swing(pieces)
    return (
        "the displacement does not follow the drive: of its "
        f"{with_unit(motion_rms * stroke_m, 'm')} rms about the mean the best fit leaves "
        f"{with_unit(residual_rms * stroke_m, 'm')} on held-out data, while "
        f"the drive moves by {with_unit((high - low) * scales.voltage_V, 'V')}; a "
        "feedback that holds the sensor, a stage that is not connected and another axis' column "
        "look like that"
    )


def _follows(piece: Piece) -> bool:
    """Tell whether the response follows its drive, at once or at equal drive levels."""
    rows = slice(piece.first, piece.last)
    drive, response = piece.drive[rows], piece.response[rows]
    if answers(drive, response):
        return True
    # not by direction as well: a servo's drive rises where its sensor reads too little
    bins = np.searchsorted(np.linspace(drive.min(), drive.max(), BINS + 1)[1:-1], drive)
    half = len(drive) // 2
    count = np.bincount(bins[:half], minlength=BINS)
    level = np.bincount(bins[:half], response[:half], BINS) / np.maximum(count, 1)
    is_known = count[bins[half:]] > 0
    measured, predicted = response[half:][is_known], level[bins[half:]][is_known]
    if not len(measured):
        return True
    return float(np.std(measured - predicted)) < FOLLOWED * float(np.std(measured))
