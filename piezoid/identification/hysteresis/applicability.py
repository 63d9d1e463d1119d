"""Applicability of the Modified Prandtl-Ishlinskii class to the data.

The class is rejected for three reasons: a loop whose opening changes sign (branches of the
operator never cross), a displacement that turns back while the drive continues (branches of an
invertible operator are monotone), and a wide loop that a lag alone explains (a sum of plays
imitates lag, with weights that hold at no other rate):

    y = c + sum_k a_k x^k, k = 1..3,     x = w^2 / (s^2 + 2 d w s + w^2) e^(-s T) u

w, d and T are searched for, with the linear coefficients eliminated. Only recordings at several
speeds distinguish a lag of second order from a loop.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from piezoid.formatting import with_unit
from piezoid.identification.extensions.linear_mode import second_order_filter
from piezoid.identification.hysteresis.order_selection import (
    Choice,
    folds_of,
    without_bends,
)
from piezoid.identification.hysteresis.pieces import Piece, Scales, response_range, widest_swing
from piezoid.identification.hysteresis.scope import limits_of, scope_of
from piezoid.identification.quality import Limit
from piezoid.numerics.arrays import Array, Samples, freeze
from piezoid.numerics.robust import white_noise_rms
from piezoid.operators.filters import later
from piezoid.records.drive_signal import is_mostly_driven, noise_of, reversals_of

MAX_ROWS = 3000  # of all pieces together: enough for three parameters
MAX_SAMPLES = 6000  # of one piece
EVALUATIONS = 15  # of the residual and its derivatives, for each start
FIRST_LAGS = (0.03, 0.3)  # over the longest lag
MAX_DAMPING = 50.0  # of critical: almost a lag of first order
# Residual of a lag over that without lag: seven lags have 0.01 to 0.08, loops 0.18 or more.
MAX_LAG_RESIDUAL = 0.12
POWERS = (1, 2, 3)
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
class SecondOrderLag:
    """A lag behind which the displacement is a cubic of the drive.

    frequency_Hz  undamped
    damping       of critical
    delay_s       beside it
    """

    frequency_Hz: float
    damping: float
    delay_s: float

    @property
    def time_s(self) -> float:
        """Return the lag of slow drives."""
        return self.damping / (np.pi * self.frequency_Hz) + self.delay_s

    @property
    def description(self) -> str:
        """Return the parameters as text, with the delay if it is a noticeable part of the lag."""
        text = f"second order, {with_unit(self.frequency_Hz, 'Hz')}, damping {self.damping:.2g}"
        has_delay = self.delay_s > 0.01 * self.time_s
        return f"{text}, delay {with_unit(self.delay_s, 's')}" if has_delay else text

    def powers(self, piece: Piece) -> Array:
        """Return the powers of the lagged drive of a piece, (samples, powers)."""
        from scipy.signal import lfilter, lfilter_zi

        w = 2.0 * np.pi * self.frequency_Hz
        b, a = second_order_filter(w, 2.0 * self.damping * w, piece.sampling_rate_Hz)
        lagged, _ = lfilter(b, a, piece.drive, zi=lfilter_zi(b, a) * piece.drive[0])
        return powers_of(later(lagged, self.delay_s * piece.sampling_rate_Hz))


def powers_of(drive: Array) -> Array:
    """Return the powers of a drive, (samples, powers)."""
    return np.column_stack([drive**power for power in POWERS])


def fit_lag(pieces: Sequence[Piece], longest_lag_s: float) -> SecondOrderLag:
    """Fit a lag without hysteresis; the coefficients of the cubic are eliminated."""

    def lag_of(x: Array) -> SecondOrderLag:
        lag_s, damping = float(np.exp(x[0])) * longest_lag_s, float(np.exp(x[1]))
        frequency_Hz = damping / (np.pi * lag_s)
        return SecondOrderLag(
            frequency_Hz=frequency_Hz, damping=damping, delay_s=float(x[2]) * longest_lag_s
        )

    def residual(x: Array) -> Array:
        lag = lag_of(x)
        return _regression(pieces, [lag.powers(piece) for piece in pieces])[1]

    lower = np.array([np.log(1e-3), np.log(0.05), 0.0])
    upper = np.array([np.log(2.0), np.log(MAX_DAMPING), 1.0])
    fits = [
        least_squares(
            residual,
            np.array([np.log(share), np.log(0.8), 0.02]),
            bounds=(lower, upper),
            x_scale=np.array([0.7, 0.4, 0.1]),
            max_nfev=EVALUATIONS,
        )
        for share in FIRST_LAGS
    ]
    return lag_of(min(fits, key=lambda fit: float(fit.cost)).x)


def _thinned(pieces: Sequence[Piece]) -> list[Piece]:
    """Return pieces of ``MAX_SAMPLES``: a lag that causes a visible loop spans many samples."""
    thinned = []
    for piece in pieces:
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
    return thinned


def _regression(pieces: Sequence[Piece], columns: Sequence[Array]) -> tuple[Array, Array]:
    """Return the coefficients of columns and the residual, each piece about its mean."""
    stride = max(1, sum(piece.rows for piece in pieces) // MAX_ROWS)
    designs, targets = [], []
    for piece, column in zip(pieces, columns, strict=True):
        rows = piece.fitted_samples(stride)
        designs.append(column[rows] - column[rows].mean(axis=0))
        targets.append(piece.response[rows] - piece.response[rows].mean())
    design, target = np.concatenate(designs), np.concatenate(targets)
    gain = np.linalg.lstsq(design, target, rcond=None)[0]
    return gain, target - design @ gain


def _held_out_error(
    pieces: Sequence[Piece], columns: Callable[[Piece], Array]
) -> tuple[float, bool]:
    """Return the held-out rms error of a cubic, and whether it rises over the whole range.

    columns  (samples, powers) of a piece, behind a lag that was fitted to all pieces
    """
    squares, rows, rises = 0.0, 0, True
    for fold in folds_of(pieces):
        training = fold.training
        gain, _ = _regression(training, [columns(piece) for piece in training])
        slope = np.polynomial.Polynomial([0.0, *gain.tolist()]).deriv()
        rises &= bool((slope(np.linspace(-1.0, 1.0, 41)) > 0.0).all())
        for number, piece in enumerate(fold.testing):
            held_out = fold.held_out_samples(number)
            error = (piece.response - columns(piece) @ gain)[held_out]
            zero = float(error.mean())
            if number < fold.halved:
                sample = training[number].fitted_samples()
                model = (columns(training[number]) @ gain)[sample]
                zero = float(np.mean(training[number].response[sample] - model))
            squares += float(np.sum((error - zero) ** 2))
            rows += len(held_out)
    return float(np.sqrt(squares / max(rows, 1))), rises


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


def limits_of_lag(
    pieces: Sequence[Piece],
    choice: Choice,
    longest_lag_s: float,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[tuple[Limit, ...], str]:
    """Return limits of the scope, and a reason to reject hysteresis if a lag fits as well, or ''.

    The lag must also explain most of the residual of a fit without lag: a wrong cable, two clocks,
    a slip or the motion of another machine is followed by neither lag nor hysteresis. Its three
    parameters are compared with hysteresis without an envelope, because the two dozen parameters
    of an envelope follow the corners of a lag at every reversal: on a positioner with lag alone,
    0.20 % of the range with an envelope, 0.57 % without, and 0.54 % for the lag. On thirteen
    published laws the error of a lag is 1.2 (loops of five sizes, Coleman and Hodgdon's) to 24
    times that of hysteresis without an envelope, and 0.18 times that of a fit without lag or more.
    The lag is fitted to all pieces and the cubic to each fold, as the plays of a fold keep the lag
    of all pieces.
    """
    scope, height, widest = scope_of(pieces), response_range(pieces), widest_opening(pieces)
    if widest <= WIDE * height:
        return limits_of(scope), ""
    progress("a lag alone, without hysteresis")
    thinned = _thinned(pieces)
    lag = fit_lag(thinned, longest_lag_s)
    error = _regression(thinned, [lag.powers(piece) for piece in thinned])[1]
    straight = without_bends(choice).best.held_out_rms
    rms, kind, is_explained = float(np.sqrt(np.mean(error**2))), "in sample", False
    if rms <= COMPARABLE * straight:  # the held-out error is larger
        without_lag, _ = _held_out_error(thinned, lambda piece: powers_of(piece.drive))
        rms, rises = _held_out_error(thinned, lag.powers)
        max_rms = min(COMPARABLE * straight, MAX_LAG_RESIDUAL * without_lag)
        kind, is_explained = "held out", rises and rms <= max_rms
    comparison = (
        f"plays without an envelope leave {100 * straight / height:.2g} % of the range held out, "
        f"a lag of {with_unit(lag.time_s, 's')} alone {100 * rms / height:.2g} % {kind}"
    )
    reason = (
        f"the loop ({100 * widest / height:.1f} % wide) is phase lag, not hysteresis: {comparison}"
        f" ({lag.description})"
    )
    return limits_of(scope, f": {comparison}"), reason if is_explained else ""


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
