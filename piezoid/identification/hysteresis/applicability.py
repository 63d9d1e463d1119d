"""Applicability of the Modified Prandtl-Ishlinskii class to the data.

Three ways it does not, each told apart before a number is believed:
a loop whose opening changes sign (the operator's branches never cross), a response that turns
back while the drive goes on (no branch of an invertible operator does), and a wide loop that a
lag alone explains (a play sum imitates lag, with weights that hold at no other rate). At one
speed a lag of second order imitates a loop as well,

    y = c + sum_k a_k x^k, k = 1..3,     x = w^2 / (s^2 + 2 d w s + w^2) e^(-s T) u

and which of them it is, another speed tells. Three numbers are sought, what is linear is solved
for at each of them; the error is on the rows that were held out of the plays as well.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order import Choice, attempt, folds_of, without_bends
from piezoid.identification.hysteresis.pieces import Piece, Scales, response_range, widest_swing
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.hysteresis.search import Settings
from piezoid.identification.quality import Limit
from piezoid.numerics.arrays import Array, Samples, freeze
from piezoid.numerics.derivative_free import direct_search
from piezoid.numerics.noise import white_noise_rms
from piezoid.operators.filters import later
from piezoid.records.constant_drive import is_mostly_driven
from piezoid.records.reversals import noise_of, reversals_of

ROWS = 3000  # of all pieces together: three numbers need no more
SAMPLES = 6000  # of one piece
EVALUATIONS = 40
EXPLAINED = 0.12  # of the residual without lag: seven lags have 0.01 to 0.08, loops 0.18 or more
POWERS = (1, 2, 3)
NO_LAG = np.array([np.log(1e-6), 0.0, 0.0])  # as shares of the longest: none
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


@dataclass(frozen=True, kw_only=True)
class LagRival:
    """A lag without hysteresis, as it was fitted.

    frequency_Hz   undamped
    damping        of critical
    held_out_rms   scaled units
    rises          whether its curve rises over the whole range: one that turns is no stage's
    """

    frequency_Hz: float
    damping: float
    held_out_rms: float
    rises: bool


def fit_lag(pieces: Sequence[Piece], longest_lag_s: float, *, numbers: int) -> LagRival:
    """Fit a second-order lag without hysteresis to pieces.

    numbers  2: frequency and damping; 3: with a delay; 0: the cubic alone, without lag
    """
    thinned = tuple(map(_thinned, pieces))
    squares, rows, x, rises = 0.0, 0, NO_LAG, True
    for fold in folds_of(thinned):
        training = fold.training
        if numbers:
            x = _search_lag(training, longest_lag_s, numbers)
        columns = [_columns(piece, x, longest_lag_s) for piece in training]
        gain, _ = _regression(training, columns)
        slope = np.polynomial.Polynomial([0.0, *gain.tolist()]).deriv()
        rises &= bool((slope(np.linspace(-1.0, 1.0, 41)) > 0.0).all())
        for number, piece in enumerate(fold.testing):
            sample = fold.unseen_samples(number)
            residual = piece.response[sample] - _columns(piece, x, longest_lag_s)[sample] @ gain
            zero = float(residual.mean())
            if number < fold.trained:
                trained = training[number].counting()
                fitted = columns[number][trained] @ gain
                zero = float(np.mean(training[number].response[trained] - fitted))
            squares += float(np.sum((residual - zero) ** 2))
            rows += len(sample)
    frequency, damping, _ = _lag_numbers(x, longest_lag_s)
    return LagRival(
        frequency_Hz=frequency,
        damping=damping,
        held_out_rms=float(np.sqrt(squares / max(rows, 1))),
        rises=rises,
    )


def _thinned(piece: Piece) -> Piece:
    """Return a piece at a lower rate: a lag that causes a visible loop spans many samples."""
    stride = max(1, len(piece.drive) // SAMPLES)
    return replace(
        piece,
        sampling_rate_Hz=piece.sampling_rate_Hz / stride,
        drive=piece.drive[::stride],
        response=piece.response[::stride],
        first=-(-piece.first // stride),
        last=-(-piece.last // stride),
        lost=piece.lost[piece.lost % stride == 0] // stride,
    )


def _lag_numbers(x: Array, longest_lag_s: float) -> tuple[float, float, float]:
    """Return frequency, damping and delay: lag 2 d / w and delay are shares of the longest."""
    lag_s, damping = float(np.exp(x[0])) * longest_lag_s, float(np.exp(x[1]))
    return damping / (np.pi * lag_s), damping, max(float(x[2]), 0.0) * longest_lag_s


def _search_lag(pieces: Sequence[Piece], longest_lag_s: float, count: int) -> Array:
    def padded(x: Array) -> Array:
        return np.concatenate([x, np.zeros(3 - count)])

    def error(x: Array) -> float:
        columns = [_columns(piece, padded(x), longest_lag_s) for piece in pieces]
        return _regression(pieces, columns)[1]

    lower = np.array([np.log(1e-3), np.log(0.05), 0.0][:count])
    upper = np.array([np.log(2.0), np.log(5.0), 1.0][:count])
    minima = [
        direct_search(
            error,
            np.array([np.log(share), np.log(0.8), 0.02][:count]),
            (lower, upper),
            initial_step=np.array([0.7, 0.4, 0.1][:count]),
            max_evaluations=EVALUATIONS * (count - 1),
        )
        for share in (0.03, 0.3)
    ]
    return padded(min(minima, key=lambda pair: pair[1])[0])


def _columns(piece: Piece, x: Array, longest_lag_s: float) -> Array:
    """Return the powers of the lagged drive of a piece, (samples, powers)."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    frequency_Hz, damping, delay_s = _lag_numbers(x, longest_lag_s)
    w = 2.0 * np.pi * frequency_Hz
    continuous = ([w**2], [1.0, 2.0 * damping * w, w**2])
    b, a, _ = cont2discrete(continuous, 1.0 / piece.sampling_rate_Hz, method="foh")
    numerator = np.ravel(b)
    lagged, _ = lfilter(numerator, a, piece.drive, zi=lfilter_zi(numerator, a) * piece.drive[0])
    lagged = later(lagged, delay_s * piece.sampling_rate_Hz)
    return np.column_stack([lagged**power for power in POWERS])


def _regression(pieces: Sequence[Piece], columns: Sequence[Array]) -> tuple[Array, float]:
    """Return the gains of columns at some rows, each piece about its mean, and their error."""
    stride = max(1, sum(piece.rows for piece in pieces) // ROWS)
    designs, targets = [], []
    for piece, column in zip(pieces, columns, strict=True):
        rows = piece.counting(stride)
        designs.append(column[rows] - column[rows].mean(axis=0))
        targets.append(piece.response[rows] - piece.response[rows].mean())
    design, target = np.concatenate(designs), np.concatenate(targets)
    gain = np.linalg.lstsq(design, target, rcond=None)[0]
    return gain, float(np.mean((target - design @ gain) ** 2))


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
    noise = max(noise_of(piece.fitted_drive), 0.02)
    return loops_of(piece.fitted_drive, piece.fitted_response, noise)


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
            height = float(np.ptp(piece.fitted_response))
            reasons.append(_contradiction(loops, height, white_noise_rms(piece.response)))
    if 2 * sum(map(bool, reasons)) < len(looped):
        return ""
    return _of_material(looped, reasons)


def _of_material(pieces: Sequence[Piece], reasons: Sequence[str]) -> str:
    """Return the first reason that most recordings over the same range have; empty: none.

    reasons  (pieces)  empty where there is none
    """
    drives = [piece.fitted_drive for piece in pieces]
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
    drive, response = piece.fitted_drive, piece.fitted_response
    bins = _bins(drive)
    count = np.bincount(bins, minlength=BINS)
    if np.ptp(drive) < 0.4 or not count.all():
        return ""
    mean = np.bincount(bins, response, BINS) / count
    height = float(np.ptp(response))
    for curve, extreme in ((mean, "minimum"), (-mean, "maximum")):
        low_end, high_end = float(curve[0] - curve.min()), float(curve[-1] - curve.min())
        if min(low_end, high_end) > BUTTERFLY * height:
            return (
                f"the loop reverses its sign (a butterfly): the displacement has its {extreme} "
                f"inside the range of the drive, {100 * low_end / height:.0f} % and "
                f"{100 * high_end / height:.0f} % of its range away from its values at the two "
                "ends. A ceramic driven beyond its coercive field, an electrostrictor and a "
                "reading without its sign do this; a sum of plays rises with the drive throughout"
            )
    return ""


def _bins(drive: Array) -> Samples:
    """Return the number of the equal part of its range in which each sample of a drive lies."""
    return np.searchsorted(np.linspace(drive.min(), drive.max(), BINS + 1)[1:-1], drive)


def _contradiction(loops: Sequence[Loop], height: float, noise: float) -> str:
    """Describe branches that turn back or loops that open the wrong way, or return ''."""
    rise, doubt = _typical([loop.rise - loop.rise.mean() for loop in loops])
    drop = float((np.maximum.accumulate(rise) - rise).max())
    if drop > TURNING * height + 6 * noise + 3 * doubt:
        return (
            f"the displacement turns back by {100 * drop / height:.1f} % of its range while the "
            "drive goes on rising; no branch of this operator does that"
        )
    opening, doubt = _typical([loop.opening for loop in loops])
    wrong, widest = float(-opening.min()), float(np.abs(opening).max())
    if wrong > max(CROSSING * widest, 8 * noise, 3 * doubt) and widest > WIDE * height / 2:
        return (
            f"the loop opens the wrong way by {100 * wrong / height:.2f} % of the range (widest "
            f"opening {100 * widest / height:.2f} %): the displacement leads the drive over part "
            "of the loop, as no sum of plays can"
        )
    return ""


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
    height = response_range(pieces)
    if widest < WIDE * height:
        return ""
    progress("a lag alone, without hysteresis")
    zones = min(choice.best.shape.below, 2)
    none = fit_lag(pieces, settings.longest_lag_s, numbers=0).held_out_rms
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


def limits_of_lag(
    pieces: Sequence[Piece],
    choice: Choice,
    longest_lag_s: float,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[tuple[Limit, ...], str]:
    """Return what was never measured, and why no hysteresis was seen where a lag does as well.

    A lag of second order is tried where no speed was varied: only there can it be a loop. Its two
    numbers stand beside hysteresis without an envelope, whose two dozen follow the corners that a
    lag makes at every turn: 0.20 % for 0.57 of a positioner that is all lag, where the lag leaves
    0.54. On thirteen published laws a lag leaves from 1.2 (loops of five sizes, Coleman and
    Hodgdon's) to 24 times what such hysteresis does, and from 0.18 of what no lag leaves.
    """
    scope = scope_of(pieces)
    if not scope.has_one_speed or scope.branches < 2:
        return scope.limits(), ""
    progress("a lag of second order, without hysteresis")
    height = response_range(pieces)
    lag, delayed, none = (fit_lag(pieces, longest_lag_s, numbers=n) for n in (2, 3, 0))
    best, plays = min(lag.held_out_rms, delayed.held_out_rms), choice.best.held_out_rms
    straight = without_bends(choice).best.held_out_rms
    envelope = ", an envelope" if choice.best.shape.bends else ""
    comparison = (
        f"held-out error: plays{envelope} and a lag {100 * plays / height:.2g} % of the range; a "
        f"second-order lag without hysteresis {100 * lag.held_out_rms / height:.2g} % "
        f"({with_unit(lag.frequency_Hz, 'Hz')}, damping {lag.damping:.2g}); the same lag with a "
        f"delay {100 * delayed.held_out_rms / height:.2g} %"
    )
    reason = ""
    is_wide = widest_opening(pieces) > WIDE * height
    explains = lag.rises and best < EXPLAINED * none.held_out_rms
    if is_wide and explains and best <= AS_GOOD * straight:
        reason = f"the loop is phase lag, not hysteresis ({comparison})"
        if straight > plays:
            reason += f"; plays without an envelope {100 * straight / height:.2g} %"
    return scope.limits(f" ({comparison})"), reason


def reason_of_error(pieces: Sequence[Piece], choice: Choice) -> str:
    """State that the error of the best fit is too large to be used, or return ''."""
    share = choice.best.held_out_rms / response_range(pieces)
    if share <= UNEXPLAINED:
        return ""
    return (
        f"the best fit leaves {100 * share:.1f} % of the displacement range on held-out data; "
        "plays, dead zones and a lag are not what this response is made of"
    )


def reason_of_no_answer(pieces: Sequence[Piece], choice: Choice, scales: Scales) -> str:
    """State that the displacement does not follow its drive, or return an empty text."""
    responses = [piece.fitted_response for piece in pieces]
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
    response = piece.fitted_response
    if is_mostly_driven(piece.fitted_drive, response):
        return True
    # not by direction as well: a servo's drive rises where its sensor reads too little
    half = len(response) // 2
    bins, later_bins = np.split(_bins(piece.fitted_drive), [half])
    count = np.bincount(bins, minlength=BINS)
    level = np.bincount(bins, response[:half], BINS) / np.maximum(count, 1)
    is_known = count[later_bins] > 0
    measured, predicted = response[half:][is_known], level[later_bins][is_known]
    if not len(measured):
        return True
    return float(np.std(measured - predicted)) < FOLLOWED * float(np.std(measured))
