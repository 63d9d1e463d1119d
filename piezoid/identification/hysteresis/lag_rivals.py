"""Lag models without hysteresis as rivals of plays: second order, with and without delay.

    y = c + sum_k a_k x^k, k = 1..3,     x = w^2 / (s^2 + 2 d w s + w^2) e^(-s T) u

At one speed a play sum imitates such a lag, and such a lag a loop: which of them it is, another
speed tells. Three numbers are sought, what is linear is solved for at each of them; the error is
on the rows that were held out of the plays as well.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.order import folds_of
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.numerics.arrays import Array
from piezoid.numerics.derivative_free import direct_search
from piezoid.operators.filters import later

ROWS = 3000  # of all pieces together: three numbers need no more
SAMPLES = 6000  # of one piece
EVALUATIONS = 40
EXPLAINED = 0.12  # of the residual without lag: seven lags have 0.01 to 0.08, loops 0.18 or more
POWERS = (1, 2, 3)
NO_LAG = np.array([np.log(1e-6), 0.0, 0.0])  # as shares of the longest: none


@dataclass(frozen=True, kw_only=True)
class LagRival:
    """A lag without hysteresis, as it was fitted.

    frequency_Hz   undamped
    damping        of critical
    delay_s        0 where there is none
    held_out_rms   scaled units
    rises          whether its curve rises over the whole range: one that turns is no stage's
    """

    frequency_Hz: float
    damping: float
    delay_s: float
    held_out_rms: float
    rises: bool


def lag_rivals(
    pieces: Sequence[Piece], longest_lag_s: float
) -> tuple[LagRival, LagRival, LagRival]:
    """Return the best second-order lag without and with a delay, and none: the cubic alone."""
    thinned = tuple(map(_thinned, pieces))
    without_delay, with_delay = (_fitted(thinned, longest_lag_s, numbers=n) for n in (2, 3))
    return without_delay, with_delay, no_lag(pieces, longest_lag_s)


def no_lag(pieces: Sequence[Piece], longest_lag_s: float) -> LagRival:
    """Return the cubic without lag: a lag needs less than EXPLAINED of its residual."""
    return _fitted(tuple(map(_thinned, pieces)), longest_lag_s, numbers=0)


def _thinned(piece: Piece) -> Piece:
    """Return a piece at a lower rate: a lag that causes a visible loop spans many samples."""
    stride = max(1, len(piece.drive) // SAMPLES)
    missing = piece.lost[piece.lost % stride == 0] // stride
    return replace(
        piece,
        sampling_rate_Hz=piece.sampling_rate_Hz / stride,
        drive=piece.drive[::stride],
        response=piece.response[::stride],
        first=-(-piece.first // stride),
        last=-(-piece.last // stride),
        lost=missing,
    )


def _fitted(pieces: Sequence[Piece], longest_lag_s: float, *, numbers: int) -> LagRival:
    squares, rows, x, rises = 0.0, 0, np.zeros(3), True
    for fold in folds_of(pieces):
        training = fold.training
        x = _searched(training, longest_lag_s, numbers) if numbers else NO_LAG
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
    frequency, damping, delay_s = _numbers(x, longest_lag_s)
    return LagRival(
        frequency_Hz=frequency,
        damping=damping,
        delay_s=delay_s,
        held_out_rms=float(np.sqrt(squares / max(rows, 1))),
        rises=rises,
    )


def _numbers(x: Array, longest_lag_s: float) -> tuple[float, float, float]:
    """Return frequency, damping and delay: lag 2 d / w and delay are shares of the longest."""
    lag_s, damping = float(np.exp(x[0])) * longest_lag_s, float(np.exp(x[1]))
    return damping / (np.pi * lag_s), damping, max(float(x[2]), 0.0) * longest_lag_s


def _searched(pieces: Sequence[Piece], longest_lag_s: float, count: int) -> Array:
    def error(x: Array) -> float:
        padded = np.concatenate([x, np.zeros(3 - count)])
        columns = [_columns(piece, padded, longest_lag_s) for piece in pieces]
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
    best, _ = min(minima, key=lambda pair: pair[1])
    return np.concatenate([best, np.zeros(3 - count)])


def _columns(piece: Piece, x: Array, longest_lag_s: float) -> Array:
    """Return the powers of the lagged drive of a piece, (samples, powers)."""
    from scipy.signal import cont2discrete, lfilter, lfilter_zi

    frequency_Hz, damping, delay_s = _numbers(x, longest_lag_s)
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
    rows = [piece.counting(stride) for piece in pieces]
    pairs = zip(columns, rows, strict=True)
    design = np.concatenate([c[r] - c[r].mean(axis=0) for c, r in pairs])
    target = np.concatenate(
        [p.response[r] - p.response[r].mean() for p, r in zip(pieces, rows, strict=True)]
    )
    gain = np.linalg.lstsq(design, target, rcond=None)[0]
    return gain, float(np.mean((target - design @ gain) ** 2))
