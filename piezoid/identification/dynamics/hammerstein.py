"""Hysteresis and dynamics of an axis in one fit, started from both found apart."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.dynamics.hammerstein_fit import fit_hammerstein
from piezoid.identification.dynamics.hammerstein_model import start_of
from piezoid.identification.dynamics.hammerstein_record import JointFit
from piezoid.identification.dynamics.hammerstein_rows import rows_of
from piezoid.identification.dynamics.hammerstein_structure import judge_structure
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

SMALL_PLAYS = (0.05, 0.1, 0.2, 0.35)  # of the exciting drive's reach
WITHIN = 0.02  # of that reach: plays nearer to each other are one


@dataclass(frozen=True, kw_only=True, eq=False)
class Joint:
    """Dynamics whose intervals know of the hysteresis, and what the joint fit says besides."""

    dynamics: LinearDynamics
    record: JointFit


def fit_jointly(
    axis: AxisModel,
    dynamics: LinearDynamics,
    exciting: Recording,
    recordings: Sequence[Recording],
) -> Joint | None:
    """Fit operator and dynamics together to all recordings whose memory is known.

    axis        whose operator is the start; its thresholds are kept
    dynamics    the start, of one path without rate gains
    exciting    the recording that drives the modes; among ``recordings``

    Plays as small as the exciting drive are put beside those of the operator: a loss angle that
    does not depend on frequency must not pass for delay. What changes when they are left out, half
    of it, counts as uncertainty of the structure. None where the recording's memory is not known.
    """
    known = {start.recording for start in axis.starts}
    held = [recording for recording in recordings if recording.name in known]
    if exciting.name not in known:
        return None
    coarse_V = axis.hysteresis.plays.threshold
    fine_V = _with_small(coarse_V, exciting.voltage_V(axis.axis))
    rows = rows_of(axis, held, threshold_V=fine_V, dynamics=dynamics)
    shape, start = start_of(axis.hysteresis, dynamics, fine_V)
    is_coarse = np.isin(fine_V, coarse_V)
    kept = np.concatenate([is_coarse, np.ones(shape.size - shape.plays, dtype=np.bool_)])
    fewer = replace(shape, plays=len(coarse_V))
    coarse = fit_hammerstein([row.of_plays(is_coarse) for row in rows], fewer, start[kept])
    start[kept] = coarse.theta
    fine = fit_hammerstein(rows, shape, start)
    place = fine.shape.linear
    change = 0.5 * (fine.theta[place] - coarse.theta[coarse.shape.linear])
    weight, zones, linear, shares = fine.shape.split(fine.theta)
    driven = next(held_rows for held_rows in rows if held_rows.recording == exciting.name)
    return Joint(
        dynamics=_moved(
            dynamics, linear, shares, fine.covariance[place, place] + np.outer(change, change)
        ),
        record=JointFit(
            recordings=tuple(held_rows.recording for held_rows in rows),
            play_threshold_V=tuple(fine_V.tolist()),
            play_weight_m_per_V=tuple(weight.tolist()),
            dead_zone_weight=tuple(zones.weight.tolist()),
            apart_rms_m=coarse.start_rms_m,
            joint_rms_m=fine.rms_m,
            structure=judge_structure(axis, fine.shape, fine.theta, fine_V, driven),
        ),
    )


def _with_small(threshold_V: Array, voltage_V: Array) -> Array:
    """Return thresholds with those of small drives among them, ascending."""
    reach_V = 2.0 * float(np.median(np.abs(voltage_V - np.median(voltage_V))))
    small_V = reach_V * np.array(SMALL_PLAYS)
    apart = np.abs(small_V[:, None] - threshold_V).min(axis=1) > WITHIN * reach_V
    return np.unique(np.concatenate([threshold_V, small_V[apart]]))


def _moved(
    dynamics: LinearDynamics, linear: Array, shares: Array, covariance: Array
) -> LinearDynamics:
    """Return the dynamics at the joint fit's shape, the gain at rest as it was."""
    n, lags = len(dynamics.mode_frequency_Hz), len(dynamics.lag_frequency_Hz)
    gains = (shares * dynamics.static_gain_m_per_V[0, 0])[:, None, None]
    order = np.argsort(linear[:n])
    lag_order = np.argsort(linear[2 * n : 2 * n + lags])
    by = np.concatenate([order, n + order, 2 * n + lag_order, [2 * n + lags]])
    return replace(
        dynamics,
        mode_frequency_Hz=np.exp(linear[:n][order]),
        mode_damping=np.exp(linear[n : 2 * n][order]),
        mode_gain_m_per_V=gains[:n][order],
        lag_frequency_Hz=np.exp(linear[2 * n : 2 * n + lags][lag_order]),
        lag_gain_m_per_V=gains[n:][lag_order],
        delay_s=float(linear[-1]),
        shape_covariance=covariance[np.ix_(by, by)],
    )
