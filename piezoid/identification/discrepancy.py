"""What the model class does not follow, as a second hysteresis: for verification, never shipped.

A model verified against its own inverse shows an error of nothing. What a stage really leaves is
at least what recordings leave that the fit did not see, and most of that is hysteresis of another
kind, so it is put behind the plant's drive as

    d[u] = sum_i sum_n c_in (z_i / reach)^n,   n = 1 .. 3

Plays with powers of their states are a Preisach operator in play form [Krejci 1996]: a class wider
than the one that ships. It is fitted to the residual, and as much larger as the error on rows left
out is than that of the fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.hysteresis.certificate import adversarial_drives
from piezoid.identification.model import AxisModel, Discrepancy
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

PLAYS = 10
POWERS = 3
MOST_ROWS = 40_000
_RIDGE = 1e-2  # of the mean square of a column: ten plays are nearly alike
_STEPPED = 20  # steps of the reach: over shorter ones a sampled slope is rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """States and residual of one piece, thinned."""

    columns: Array
    residual_m: Array


def with_discrepancy(axis: AxisModel, recordings: Sequence[Recording]) -> AxisModel:
    """Return the axis with what its class does not follow on the recordings of its fit.

    recordings  of the fit; one that the model does not know is passed over

    Without such recordings it stays unknown, and verification says so by its figures alone.
    """
    low_V, high_V = axis.voltage_V
    centre_V, reach_V = 0.5 * (low_V + high_V), 0.5 * (high_V - low_V)
    threshold_V = reach_V * np.linspace(0.0, 0.9, PLAYS)
    parts = [rows for r in recordings for rows in _rows(axis, r, threshold_V, centre_V, reach_V)]
    if not parts:
        return replace(axis, discrepancy=None)
    columns = np.concatenate([part.columns for part in parts])
    residual_m = np.concatenate([part.residual_m for part in parts])
    weight_m = np.linalg.solve(
        columns.T @ columns
        + _RIDGE * np.trace(columns.T @ columns) / columns.shape[1] * np.eye(columns.shape[1]),
        columns.T @ residual_m,
    )
    unseen = max(axis.quality.held_out_rms_m / axis.quality.rms_m, 1.0)
    shape = Discrepancy(
        centre_V=centre_V,
        reach_V=reach_V,
        threshold_V=threshold_V,
        weight_m=weight_m.reshape(POWERS, PLAYS) * unseen,
        steepest_m_per_V=0.0,
    )
    return replace(axis, discrepancy=replace(shape, steepest_m_per_V=_steepest_m_per_V(shape)))


def _rows(
    axis: AxisModel, recording: Recording, threshold_V: Array, centre_V: float, reach_V: float
) -> list[_Rows]:
    """Return what is known of every piece of one recording, without its mean."""
    try:
        simulated_m = simulate_recording(axis, recording)
    except IdentificationError:
        return []
    drive_V = recording.voltage_V(axis.axis)
    residual_m = axis.polarity * (recording.displacement_m(axis.axis) - simulated_m)
    known = np.isfinite(residual_m)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], known.astype(int), [0]])))
    step = max(recording.samples // MOST_ROWS, 1)
    found = []
    for first, last in pairwise(edges.tolist()):
        if not known[first]:
            continue
        states = states_of(drive_V[first:last], threshold_V, centre_V, reach_V)[::step]
        rest_m = residual_m[first:last:step]
        found.append(
            _Rows(columns=states - states.mean(axis=0), residual_m=rest_m - rest_m.mean())
        )
    return found


def states_of(drive_V: Array, threshold_V: Array, centre_V: float, reach_V: float) -> Array:
    """Return the powers of the plays' states, (samples, powers * plays), power by power."""
    away_V = drive_V - centre_V
    first_V = np.clip(np.zeros(len(threshold_V)), away_V[0] - threshold_V, away_V[0] + threshold_V)
    z = play_columns(away_V, threshold_V, first_V)[0] / reach_V
    return np.hstack([z**n for n in range(1, POWERS + 1)])


def _steepest_m_per_V(shape: Discrepancy) -> float:
    """Return the steepest rise or fall found over the adversarial drives of the certificate."""
    drive_V = shape.centre_V + adversarial_drives(shape.reach_V, seed=0)
    moved_m = (
        states_of(drive_V, shape.threshold_V, shape.centre_V, shape.reach_V)
        @ shape.weight_m.ravel()
    )
    step_V = np.diff(drive_V)
    long = np.abs(step_V) > shape.reach_V / (_STEPPED * PLAYS)
    return float(np.abs(np.diff(moved_m)[long] / step_V[long]).max(initial=0.0))
