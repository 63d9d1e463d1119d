"""Sizes: how large a cause is, with an interval from blocks that count as independent.

Coefficients and nonlinear parameters are judged together, by the columns of the one and the
tangents of the other beside the whole null; the size is a function of both,

    var size = g' cov g + (k size)^2,    g = its gradient by small steps,

k what the law of the effect may itself be wrong by.

A share of the stroke is the root of what the blocks explain, known to as many standard errors as
the effect itself.

Source: the delta method; Liang & Zeger, Biometrika 73 (1986) for the covariance.
"""

from dataclasses import replace
from math import hypot, sqrt

import numpy as np

from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.diagnosis import Size
from piezoid.diagnosis.refinement import with_step
from piezoid.diagnosis.refitted_view import (
    SelectedEffect,
    filter_offset,
    with_filtered_drive,
    without_ringing,
)
from piezoid.diagnosis.residual_view import View
from piezoid.numerics.arrays import Array

NUDGE = 0.1  # of a parameter's width
QUANTILE = 2.0  # of Student's distribution for some sixty blocks


def size_of(cause: Candidate) -> Size:
    """Return a cause's size with its 95 % interval."""
    effect, one = cause.effect, cause.selected
    beta = cause.cv.coefficient
    if effect.size is None:
        value = 100.0 * cause.share
        # what blocks explain is known to one part in z, its root to half of that
        reach = QUANTILE * value / (2.0 * max(cause.cv.z, 1.0))
    else:
        value = effect.size(_seen(cause), one.parameters, beta)
        reach = QUANTILE * hypot(_spread(cause, value), effect.model_error * value)
    return Size(value=value, unit=effect.unit, ci95=(value - reach, value + reach))


def _seen(cause: Candidate) -> View:
    """Return the view in which a size is seen: what a limit cuts off is there without it only."""
    return cause.without if cause.effect.drive_filter is not None else cause.view


def _spread(cause: Candidate, value: float) -> float:
    """Return the standard error of a size that coefficients and parameters make together."""
    effect, one, view, seen = cause.effect, cause.selected, cause.view, _seen(cause)
    assert effect.size is not None
    beta = cause.cv.coefficient
    columns = [_nudged(cause, name) for name in one.free]
    gradient = [
        (effect.size(seen, with_step(one, name, NUDGE).parameters, beta) - value) / NUDGE
        for name in one.free
    ]
    if one.adds_columns and effect.columns is not None:
        columns += list(effect.columns(without_ringing(view, [one]), one.parameters).T)
        for k in range(len(beta)):
            more = beta + np.eye(len(beta))[k] * max(abs(beta[k]), 1e-9) * NUDGE
            step = more[k] - beta[k]
            gradient.append((effect.size(view, one.parameters, more) - value) / step)
    # a parameter that moves nothing here is in no reading, nor in what the cause adds to them
    moving = [k for k, column in enumerate(columns) if np.any(column)]
    null = replace(view, selected=cause.without.selected).null
    cov = null.clustered_covariance(np.column_stack([columns[k] for k in moving]))
    slope = np.array([gradient[k] for k in moving])
    return sqrt(max(float(slope @ cov @ slope), 0.0))


def _nudged(cause: Candidate, name: str) -> Array:
    """Return how fast the response changes with a free parameter, in parts of its width."""
    one, view = cause.selected, cause.view
    there = with_step(one, name, NUDGE)
    effect = one.effect
    if effect.response_filter is not None:
        change = filter_offset(view, [there]) - filter_offset(view, [one])
    elif effect.drive_filter is not None:
        change = _of_drive(cause, there)
    else:
        assert effect.columns is not None
        here = without_ringing(view, [one])
        moved = effect.columns(here, there.parameters) - effect.columns(here, one.parameters)
        change = moved @ cause.cv.coefficient
    return np.asarray(change / NUDGE)


def _of_drive(cause: Candidate, there: SelectedEffect) -> Array:
    view = cause.view
    other: View = with_filtered_drive(cause.without, [there])
    parts = [
        view.nuisance.static_rows(k, view.weight, track.drive) - view.static[k][track.place]
        for k, track in enumerate(other.tracks)
    ]
    return np.concatenate(parts)
