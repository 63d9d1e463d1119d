"""Size of an effect, with an interval from independent blocks.

The size is a function of coefficients and nonlinear parameters. Their joint covariance is that of
the columns of the coefficients and the tangents of the parameters, beside the whole null:

    var size = g' cov g + (k size)^2,    g the gradient of the size by small steps,

k the relative error of the size by the law of the effect.

A size as a share of the stroke is the root of the explained power, and its relative error half of
that of the power.

Source: the delta method; Liang & Zeger, Biometrika 73 (1986) for the covariance.
"""

from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.diagnosis import Size
from piezoid.diagnosis.refinement import with_step
from piezoid.diagnosis.refitted_view import (
    filter_offset,
    with_filtered_drive,
    without_ringing,
)
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array

NUDGE = 0.1  # of a parameter's width
QUANTILE = 2.0  # of Student's distribution for some sixty blocks


def size_of(cause: Candidate) -> Size:
    """Return the size of a cause with its 95 % interval."""
    effect, selected = cause.effect, cause.selected
    beta = cause.cv.coefficient
    if effect.size is None:
        value = 100.0 * cause.share
        # the relative error of the explained power is 1/z; its root has half of that
        margin = QUANTILE * value / (2.0 * max(cause.cv.z, 1.0))
    else:
        value = effect.size(_size_view(cause), selected.parameters, beta)
        margin = QUANTILE * hypot(_standard_error(cause, value), effect.model_error * value)
    return Size(value=value, unit=effect.unit, ci95=(value - margin, value + margin))


def _size_view(cause: Candidate) -> View:
    """Return the view for the size of an effect: without the effect if it filters the drive."""
    return cause.without if cause.effect.drive_filter is not None else cause.view


def _standard_error(cause: Candidate, value: float) -> float:
    """Return the standard error of a size by the errors of coefficients and parameters."""
    effect, selected, view, size_view = cause.effect, cause.selected, cause.view, _size_view(cause)
    assert effect.size is not None
    beta = cause.cv.coefficient
    columns = [_parameter_column(cause, name) for name in selected.free]
    gradient = [
        (effect.size(size_view, with_step(selected, name, NUDGE).parameters, beta) - value) / NUDGE
        for name in selected.free
    ]
    if selected.adds_columns and effect.columns is not None:
        columns += list(effect.columns(without_ringing(view, [selected]), selected.parameters).T)
        for k in range(len(beta)):
            nudged = beta + np.eye(len(beta))[k] * max(abs(beta[k]), 1e-9) * NUDGE
            step = nudged[k] - beta[k]
            gradient.append((effect.size(view, selected.parameters, nudged) - value) / step)
    # a parameter without influence on these recordings does not change the size either
    influential = [k for k, column in enumerate(columns) if np.any(column)]
    null = replace(view, selected=cause.without.selected).null
    cov = null.clustered_covariance(np.column_stack([columns[k] for k in influential]))
    slope = np.array([gradient[k] for k in influential])
    return sqrt(max(float(slope @ cov @ slope), 0.0))


def _parameter_column(cause: Candidate, name: str) -> Array:
    """Return the derivative of the response by a free parameter, per step width."""
    selected, view = cause.selected, cause.view
    nudged = with_step(selected, name, NUDGE)
    effect = selected.effect
    if effect.response_filter is not None:
        change = filter_offset(view, [nudged]) - filter_offset(view, [selected])
    elif effect.drive_filter is not None:
        tracks = with_filtered_drive(cause.without, [nudged]).tracks
        parts = [
            view.nuisance.static_rows(k, view.weight, track.drive) - view.static[k][track.rows]
            for k, track in enumerate(tracks)
        ]
        change = np.concatenate(parts)
    else:
        assert effect.columns is not None
        baseline = without_ringing(view, [selected])
        difference = effect.columns(baseline, nudged.parameters) - effect.columns(
            baseline, selected.parameters
        )
        change = difference @ cause.cv.coefficient
    return np.asarray(change / NUDGE)
