"""Applicability of the Modified Prandtl-Ishlinskii class to the data.

The class is rejected for three reasons: a loop whose opening changes sign (branches of the
operator never cross), a displacement that turns back while the drive continues (branches of an
invertible operator are monotone), and a wide loop that a lag alone explains (a sum of plays
imitates lag, with weights that hold at no other rate). At one speed a second-order lag imitates a
loop as well,

    y = c + sum_k a_k x^k, k = 1..3,     x = w^2 / (s^2 + 2 d w s + w^2) e^(-s T) u

and only recordings at another speed distinguish the two. w, d and T are searched for, with the
linear coefficients eliminated; the error is that on the rows held out of the fits of plays.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.order_selection import (
    Choice,
    fit_trial,
    folds_of,
    without_bends,
)
from piezoid.identification.hysteresis.pieces import Piece, Scales, response_range, widest_swing
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.hysteresis.search import Settings
from piezoid.identification.quality import Limit
from piezoid.numerics.arrays import Array, Samples, freeze
from piezoid.numerics.derivative_free import direct_search
from piezoid.numerics.robust import white_noise_rms
from piezoid.operators.filters import later
from piezoid.records.constant_drive import is_mostly_driven
from piezoid.records.reversals import noise_of, reversals_of

MAX_ROWS = 3000  # of all pieces together: enough for three parameters
MAX_SAMPLES = 6000  # of one piece
EVALUATIONS = 40  # per parameter beyond the first
# Residual of a lag over that without lag: seven lags have 0.01 to 0.08, loops 0.18 or more.
MAX_LAG_RESIDUAL = 0.12
POWERS = (1, 2, 3)
NO_LAG = np.array([np.log(1e-6), 0.0, 0.0])  # logarithms of lag and damping, delay
WIDE = 0.01  # of the displacement range: a narrower loop needs no explanation
MAX_CROSSING = 0.15  # of the widest opening: how far a loop may open the wrong way
BINS = 20  # of the drive, in each of which the branches are averaged
MIN_BUTTERFLY = 0.25  # of the displacement range: distance of both ends from the extremum
RANGE_MARGIN = 0.1  # of a drive's range at either end: ranges that differ by less count as equal
MAX_TURN_BACK = 0.05  # of the displacement range, on one branch
MAX_RESIDUAL = 0.08  # of the displacement range: held-out rms of a usable fit
MAX_UNEXPLAINED = 0.7  # residual over rms of the motion: half of the power is explained
POINTS = 41  # of the grid on which a loop's branches are compared
MAX_JUMP = 0.2  # of a branch, between two samples: a parabola's chord is off by its square, 4 %
COMPARABLE = 1.1  # held-out error of the lag alone over that of the hysteresis model


@dataclass(frozen=True, kw_only=True)
class LagModel:
    """A fitted second-order lag without hysteresis.

    frequency_Hz   undamped
    damping        of critical
    held_out_rms   scaled units
    is_monotone    whether its static curve rises over the whole range, as that of any stage does
    """

    frequency_Hz: float
    damping: float
    held_out_rms: float
    is_monotone: bool


def fit_lag(pieces: Sequence[Piece], longest_lag_s: float, *, parameters: int) -> LagModel:
    """Fit a second-order lag without hysteresis to pieces.

    parameters  2: frequency and damping; 3: and a delay; 0: the cubic alone, without lag
    """
    thinned = []
    for piece in pieces:  # a lag that causes a visible loop spans many samples
        stride = max(1, len(piece.drive) // MAX_SAMPLES)
        thinned.append(
            replace(
                piece,
                sampling_rate_Hz=piece.sampling_rate_Hz / stride,
                drive=piece.drive[::stride],
                response=piece.response[::stride],
                first=-(-piece.first // stride),
                last=-(-piece.last // stride),
                invalid=piece.invalid[piece.invalid % stride == 0] // stride,
            )
        )
    squares, rows, x, is_monotone = 0.0, 0, NO_LAG, True
    for fold in folds_of(thinned):
        training = fold.training
        if parameters:
            x = _search_lag(training, longest_lag_s, parameters)
        columns = [_columns(piece, x, longest_lag_s) for piece in training]
        gain, _ = _regression(training, columns)
        slope = np.polynomial.Polynomial([0.0, *gain.tolist()]).deriv()
        is_monotone &= bool((slope(np.linspace(-1.0, 1.0, 41)) > 0.0).all())
        for number, piece in enumerate(fold.testing):
            held_out = fold.held_out_samples(number)
            columns_of_piece = _columns(piece, x, longest_lag_s)
            residual = piece.response[held_out] - columns_of_piece[held_out] @ gain
            zero = float(residual.mean())
            if number < fold.halved:
                sample = training[number].fitted_samples()
                model = columns[number][sample] @ gain
                zero = float(np.mean(training[number].response[sample] - model))
            squares += float(np.sum((residual - zero) ** 2))
            rows += len(held_out)
    frequency, damping, _ = _frequency_damping_delay(x, longest_lag_s)
    return LagModel(
        frequency_Hz=frequency,
        damping=damping,
        held_out_rms=float(np.sqrt(squares / max(rows, 1))),
        is_monotone=is_monotone,
    )


def _frequency_damping_delay(x: Array, longest_lag_s: float) -> tuple[float, float, float]:
    """Return frequency (Hz), damping and delay (s).

    x  logarithms of the lag 2 d / w and of the damping, delay; lag and delay over the longest lag
    """
    lag_s, damping = float(np.exp(x[0])) * longest_lag_s, float(np.exp(x[1]))
    return damping / (np.pi * lag_s), damping, max(float(x[2]), 0.0) * longest_lag_s


def _search_lag(pieces: Sequence[Piece], longest_lag_s: float, count: int) -> Array:
    """Return logarithms of lag and damping, and the delay, of which ``count`` are fitted."""

    def error(x: Array) -> float:
        columns = [_columns(piece, np.pad(x, (0, 3 - count)), longest_lag_s) for piece in pieces]
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
    return np.pad(min(minima, key=lambda pair: pair[1])[0], (0, 3 - count))


def _columns(piece: Piece, x: Array, longest_lag_s: float) -> Array:
    """Return the powers of the lagged drive of a piece, (samples, powers)."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    frequency_Hz, damping, delay_s = _frequency_damping_delay(x, longest_lag_s)
    w = 2.0 * np.pi * frequency_Hz
    continuous = ([w**2], [1.0, 2.0 * damping * w, w**2])
    b, a, _ = cont2discrete(continuous, 1.0 / piece.sampling_rate_Hz, method="foh")
    numerator = np.ravel(b)
    lagged, _ = lfilter(numerator, a, piece.drive, zi=lfilter_zi(numerator, a) * piece.drive[0])
    lagged = later(lagged, delay_s * piece.sampling_rate_Hz)
    return np.column_stack([lagged**power for power in POWERS])


def _regression(pieces: Sequence[Piece], columns: Sequence[Array]) -> tuple[Array, float]:
    """Return the coefficients of columns and the mean square error, each piece about its mean."""
    stride = max(1, sum(piece.rows for piece in pieces) // MAX_ROWS)
    designs, targets = [], []
    for piece, column in zip(pieces, columns, strict=True):
        rows = piece.fitted_samples(stride)
        designs.append(column[rows] - column[rows].mean(axis=0))
        targets.append(piece.response[rows] - piece.response[rows].mean())
    design, target = np.concatenate(designs), np.concatenate(targets)
    gain = np.linalg.lstsq(design, target, rcond=None)[0]
    return gain, float(np.mean((target - design @ gain) ** 2))


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """The opening of one loop: falling branch minus rising branch at the same drive.

    drive     (points,)  inside the range that both branches share
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

    Branches with large jumps of the drive are skipped.

    drive, response  (samples,)
    noise            excursions of the drive that are no reversal
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


def _loops_of_piece(piece: Piece) -> tuple[Loop, ...]:
    noise = max(noise_of(piece.fitted_drive), 0.02)
    return loops_of(piece.fitted_drive, piece.fitted_response, noise)


def reason_in_loops(pieces: Sequence[Piece]) -> str:
    """Return why the recorded loops contradict the class, or ''.

    A material contradicts the class in every recording over the same range. A contradiction in
    half of them or fewer has causes in the recording: slew limit or long lag of a fast drive. The
    same holds for branches that turn back or loops that open the wrong way in less than half of
    all recordings with loops: a clock that slipped, an initial state, creep between levels.
    """
    butterfly = _reason_of_majority(pieces, [_butterfly(piece) for piece in pieces])
    if butterfly:
        return butterfly
    pieces_with_loops, reasons = [], []
    for piece in pieces:
        loops = [loop for loop in _loops_of_piece(piece) if loop.span > 0.4]
        if loops:
            pieces_with_loops.append(piece)
            height = float(np.ptp(piece.fitted_response))
            reasons.append(_contradiction(loops, height, white_noise_rms(piece.response)))
    if 2 * sum(map(bool, reasons)) < len(pieces_with_loops):
        return ""
    return _reason_of_majority(pieces_with_loops, reasons)


def _reason_of_majority(pieces: Sequence[Piece], reasons: Sequence[str]) -> str:
    """Return the first reason that holds for most pieces over the same range, or ''.

    reasons  (pieces)  '' for a piece that does not contradict the class
    """
    drives = [piece.fitted_drive for piece in pieces]
    ranges = [(float(drive.min()), float(drive.max())) for drive in drives]
    for piece, (low, high), reason in zip(pieces, ranges, reasons, strict=True):
        margin = RANGE_MARGIN * (high - low)
        contradicts = [
            bool(text)
            for text, (lowest, highest) in zip(reasons, ranges, strict=True)
            if lowest <= low + margin and highest >= high - margin
        ]
        if reason and 2 * sum(contradicts) > len(contradicts):
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
        if min(low_end, high_end) > MIN_BUTTERFLY * height:
            return (
                f"the loop reverses its sign (a butterfly): the displacement has its {extreme} "
                f"inside the range of the drive, {100 * low_end / height:.0f} % and "
                f"{100 * high_end / height:.0f} % of its range away from its values at the two "
                "ends. A ceramic driven beyond its coercive field, an electrostrictor and a "
                "reading without its sign do this; a sum of plays rises with the drive throughout"
            )
    return ""


def _bins(drive: Array) -> Samples:
    """Return the index of the bin of its range in which each sample of a drive lies."""
    return np.searchsorted(np.linspace(drive.min(), drive.max(), BINS + 1)[1:-1], drive)


def _contradiction(loops: Sequence[Loop], height: float, noise: float) -> str:
    """Describe branches that turn back or loops that open the wrong way, or return ''."""
    rise, error = _median_curve([loop.rise - loop.rise.mean() for loop in loops])
    drop = float((np.maximum.accumulate(rise) - rise).max())
    if drop > MAX_TURN_BACK * height + 6 * noise + 3 * error:
        return (
            f"the displacement turns back by {100 * drop / height:.1f} % of its range while the "
            "drive goes on rising; no branch of this operator does that"
        )
    opening, error = _median_curve([loop.opening for loop in loops])
    wrong, widest = float(-opening.min()), float(np.abs(opening).max())
    if wrong > max(MAX_CROSSING * widest, 8 * noise, 3 * error) and widest > WIDE * height / 2:
        return (
            f"the loop opens the wrong way by {100 * wrong / height:.2f} % of the range (widest "
            f"opening {100 * widest / height:.2f} %): the displacement leads the drive over part "
            "of the loop, as no sum of plays can"
        )
    return ""


def _median_curve(curves: Sequence[Array]) -> tuple[Array, float]:
    """Return the pointwise median of curves and its standard error."""
    median = np.median(curves, axis=0)
    scatter = float(np.sqrt(np.mean((np.array(curves) - median) ** 2)))
    return np.asarray(median), scatter / float(np.sqrt(len(curves)))


def widest_opening(pieces: Sequence[Piece]) -> float:
    """Return the opening of the widest loop, scaled units."""
    loops = [loop for piece in pieces for loop in _loops_of_piece(piece)]
    return max((float(loop.opening.max()) for loop in loops), default=0.0)


def reason_of_lag(
    pieces: Sequence[Piece],
    choice: Choice,
    settings: Settings,
    progress: Callable[[str], None] = lambda _: None,
) -> str:
    """Return a reason to reject hysteresis if a lag alone predicts a wide loop as well, or ''.

    The lag must also explain most of the residual of a fit without lag: a wrong cable, two clocks,
    a slip or the motion of another machine is followed by neither lag nor hysteresis.
    """
    widest = widest_opening(pieces)
    height = response_range(pieces)
    if widest < WIDE * height:
        return ""
    progress("a lag alone, without hysteresis")
    zones = min(choice.best.shape.below, 2)
    without_lag = fit_lag(pieces, settings.longest_lag_s, parameters=0).held_out_rms
    max_rms = min(COMPARABLE * choice.best.held_out_rms, MAX_LAG_RESIDUAL * without_lag)
    for lag in ("first_order", "delay"):
        shape = Shape(plays=0, below=zones, above=zones, lag=lag)
        trial = fit_trial(pieces, shape, replace(settings, lag_s=None), max_rms=max_rms)
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
    """Return limits of the scope, and a reason to reject hysteresis if a lag fits as well, or ''.

    A second-order lag is tried only if the speed was not varied: at several speeds it cannot
    imitate a loop. Its two parameters are compared with hysteresis without an envelope, because
    the two dozen parameters of an envelope follow the corners of a lag at every reversal: on a
    positioner with lag alone, 0.20 % of the range with an envelope, 0.57 % without, and 0.54 % for
    the lag. On thirteen published laws the error of a lag is 1.2 (loops of five sizes, Coleman and
    Hodgdon's) to 24 times that of hysteresis without an envelope, and 0.18 times that of a fit
    without lag or more.
    """
    scope = scope_of(pieces)
    if not scope.has_one_speed or scope.branches < 2:
        return scope.limits(), ""
    progress("a lag of second order, without hysteresis")
    height = response_range(pieces)
    lag, delayed, without_lag = (
        fit_lag(pieces, longest_lag_s, parameters=count) for count in (2, 3, 0)
    )
    lag_rms, plays = min(lag.held_out_rms, delayed.held_out_rms), choice.best.held_out_rms
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
    max_rms = MAX_LAG_RESIDUAL * without_lag.held_out_rms
    is_explained = lag.is_monotone and lag_rms < max_rms
    if is_wide and is_explained and lag_rms <= COMPARABLE * straight:
        reason = f"the loop is phase lag, not hysteresis ({comparison})"
        if straight > plays:
            reason += f"; plays without an envelope {100 * straight / height:.2g} %"
    return scope.limits(f" ({comparison})"), reason


def reason_of_error(pieces: Sequence[Piece], choice: Choice) -> str:
    """State that the error of the best fit is too large to be used, or return ''."""
    share = choice.best.held_out_rms / response_range(pieces)
    if share <= MAX_RESIDUAL:
        return ""
    return (
        f"the held-out error of the best fit is {100 * share:.1f} % of the displacement range: "
        "plays, dead zones and a lag do not describe this response"
    )


def reason_of_no_response(pieces: Sequence[Piece], choice: Choice, scales: Scales) -> str:
    """State that the displacement does not follow its drive, or return ''."""
    responses = [piece.fitted_response for piece in pieces]
    motion_rms = float(np.sqrt(np.mean(np.concatenate([(y - y.mean()) ** 2 for y in responses]))))
    residual_rms = choice.best.held_out_rms
    if residual_rms <= MAX_UNEXPLAINED * motion_rms:
        return ""
    for piece in pieces:
        response = piece.fitted_response
        if is_mostly_driven(piece.fitted_drive, response):
            return ""
        # Rising and falling drive together, at equal levels: a servo raises its drive where the
        # sensor reads too little.
        half = len(response) // 2
        bins, later_bins = np.split(_bins(piece.fitted_drive), [half])
        count = np.bincount(bins, minlength=BINS)
        level = np.bincount(bins, response[:half], BINS) / np.maximum(count, 1)
        is_filled = count[later_bins] > 0
        measured, predicted = response[half:][is_filled], level[later_bins][is_filled]
        error_rms = float(np.std(measured - predicted)) if len(measured) else 0.0
        if not len(measured) or error_rms < MAX_UNEXPLAINED * float(np.std(measured)):
            return ""
    stroke_m = abs(scales.displacement_m)
    low, high = widest_swing(pieces)
    return (
        "the displacement does not follow the drive: the held-out error of the best fit is "
        f"{with_unit(residual_rms * stroke_m, 'm')} rms, the motion about its mean "
        f"{with_unit(motion_rms * stroke_m, 'm')} rms, while the drive moves by "
        f"{with_unit((high - low) * scales.voltage_V, 'V')}. Possible causes: a feedback that "
        "holds the sensor, a stage that is not connected, the column of another axis"
    )
