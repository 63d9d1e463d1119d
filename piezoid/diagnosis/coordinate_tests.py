"""Find the coordinate (time, drive, position, ...) along which the residual is systematic.

Curves along a signal are tested against randomly shifted residuals, a separate course of each
recording in time against random signs of short intervals, and periodic curves against the spectrum
around their frequency. Hysteresis that the nuisance class cannot follow is systematic as well, so
the gain must also exceed that of healthy stages (``null_distribution``).
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.coordinate_bases import (
    TIME_KNOTS,
    reading_basis,
    signal_bases,
    time_basis,
    time_spline,
)
from piezoid.diagnosis.coordinate_scores import (
    RIDGE,
    SURROGATES,
    CoordinateScore,
    Residual,
)
from piezoid.diagnosis.null_distribution import rank_p_value
from piezoid.diagnosis.periodic_residual import score_periodic
from piezoid.numerics.arrays import Array

READING_SURROGATES = 5
CHUNKS = 5  # of the time between two knots; neighbouring chunks are in different folds
ROUNDS = 12  # of fitting a course in time and the null in turn


def score_coordinates(residual: Residual) -> tuple[CoordinateScore, ...]:
    """Score a curve along each coordinate, the largest gain first.

    The p-value of a curve along a signal is the share of surrogates for which a curve along any
    signal has as large a gain. That of a periodic curve compares its power with the spectrum
    around its frequency.
    """
    rng = np.random.default_rng(0)
    surrogates = residual.surrogates(rng)
    scores, largest = residual.score_all(signal_bases(residual.view), surrogates)
    reading = _score_reading(residual, surrogates)
    scores += [
        replace(reading, p_value=rank_p_value(reading.gain, largest)),
        _score_time(residual, rng),
        *score_periodic(residual),
    ]
    return tuple(sorted(scores, key=lambda score: -score.gain))


def _score_reading(residual: Residual, surrogates: Array) -> CoordinateScore:
    """Score the measured value, relative to measured values with surrogate residuals.

    Every residual is a part of the measured value and therefore correlated with it.
    """
    score = residual.score(reading_basis(residual.view))
    surrogate_gains = []
    for j in range(READING_SURROGATES):
        columns, _ = residual.unit_columns(reading_basis(residual.view, surrogates[:, j]))
        surrogate_gains.append(
            float(residual.held_out_gains(columns, surrogates[:, j : j + 1])[0])
        )
    return replace(score, gain=score.gain - max(*surrogate_gains, 0.0))


def _score_time(residual: Residual, rng: np.random.Generator) -> CoordinateScore:
    """Score a separate curve in time for each recording on left-out intervals.

    The null distribution comes from random signs of the intervals. It assumes that the residual is
    not correlated for longer than a fifth of the distance of two knots, which may not hold for
    hysteresis.
    """
    explained, coefficients, fitted = np.zeros(1 + SURROGATES), [], []
    for k, track in enumerate(residual.view.tracks):
        values = residual.values[residual.view.track_rows(k)]
        columns = time_spline(track)
        chunk = np.arange(len(values)) * TIME_KNOTS * CHUNKS // max(len(values), 1)
        signs = rng.choice([-1.0, 1.0], (TIME_KNOTS * CHUNKS, SURROGATES))[chunk]
        trials = np.column_stack([values, values[:, None] * signs])
        ridge = _time_ridge(values)
        for fold in range(CHUNKS):
            is_out = chunk % CHUNKS == fold
            training = columns[~is_out]
            beta = np.linalg.solve(training.T @ training + ridge, training.T @ trials[~is_out])
            predicted = columns[is_out] @ beta
            explained += np.sum((2.0 * trials[is_out] - predicted) * predicted, axis=0)
        coefficients.append(np.linalg.solve(columns.T @ columns + ridge, columns.T @ values))
        fitted.append(columns @ coefficients[-1])
    gains = explained / max(float(np.sum(residual.values**2)), 1e-300)
    return CoordinateScore(
        basis=time_basis(residual.view),
        gain=float(gains[0]),
        p_value=rank_p_value(float(gains[0]), gains[1:]),
        coefficients=np.concatenate(coefficients),
        fitted=np.concatenate(fitted),
    )


def fit_time_course(residual: Residual, score: CoordinateScore) -> CoordinateScore:
    """Fit the curves in time and the null alternately, which converges to the joint fit."""
    view, null = residual.view, residual.null
    columns = [time_spline(track) for track in view.tracks]
    coefficients = np.zeros((len(columns), TIME_KNOTS))
    course = np.zeros(len(view.response))
    for _ in range(ROUNDS):
        remaining = null.project_out(view.response - course)
        for k, spline in enumerate(columns):
            rows = view.track_rows(k)
            ridge = _time_ridge(remaining[rows])
            step = np.linalg.solve(spline.T @ spline + ridge, spline.T @ remaining[rows])
            coefficients[k] += step
            course[rows] += spline @ step
    return replace(score, coefficients=coefficients.ravel(), fitted=null.project_out(course))


def _time_ridge(values: Array) -> Array:
    return np.asarray(RIDGE * len(values) / TIME_KNOTS * np.eye(TIME_KNOTS))
