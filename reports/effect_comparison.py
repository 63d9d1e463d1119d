"""Residuals without and with one effect, and the look-alike: a healthy stage with that effect.

If the model contains the effect as an extension, the residual without the effect is the
measurement minus the model without that extension. For all other effects the tangent columns are
fitted to the residual together with the Jacobian of the model. The residual without such an effect
is then the remaining residual plus the contribution of the effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding
from piezoid.diagnosis.drive_response import (
    driven_recording,
    null_columns,
    rows_of,
)
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.planning.open_questions import suspect_of
from piezoid.diagnosis.planning.separation import basis_of, block_of, scale_of
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity
from piezoid_reports.page import Trace, rms

ROWS = 3000  # of each recording
MIN_SHARE = 1e-6  # of the stroke: a smaller effect is not simulated
MAX_RECORDINGS = 6  # with the largest residuals

# Tangents fitted to one recording: indices of the samples, residual with every tangent fitted
# (rows,), and by effect the contribution that the parameters of the model cannot imitate (rows,)
# and the total contribution (samples,).
TangentFit = tuple[NDArray[np.int_], Array, Mapping[str, Array], Mapping[str, Array]]


@dataclass(frozen=True, kw_only=True, eq=False)
class EffectSimulation:
    """Residuals of one recording without and with an effect.

    rows         (rows,)  indices of the samples
    without_m    (rows,)  residual without the effect in the model
    with_m       (rows,)  residual with the effect in the model
    lookalike_m  (rows,)  residual of a healthy stage to which the effect and noise are added
    """

    trace: Trace
    rows: NDArray[np.int_]
    without_m: Array
    with_m: Array
    lookalike_m: Array


def compare_effects(
    axis: AxisModel, traces: Sequence[Trace], diagnosis: Diagnosis
) -> dict[str, tuple[EffectSimulation, ...]]:
    """Return by effect the residuals without and with it, largest residual first."""
    worst = traces[:MAX_RECORDINGS]
    if not worst:
        return {}
    effects = [f for f in diagnosis.findings if f.effect != SOMETHING_ELSE]
    missing = [
        f for f in effects if effect_named(f.effect).without(axis, worst[0].recording) is None
    ]
    fits = _fit_tangents(axis, worst, missing, diagnosis.stroke_m)
    comparisons = {}
    for finding in effects:
        simulations = [
            _simulate(axis, finding.effect, trace, fit)
            for trace, fit in zip(worst, fits, strict=True)
        ]
        # The look-alike gets the sign of the effect.
        correlation = 0.0
        for simulation in simulations:
            lookalike_m = simulation.lookalike_m - simulation.lookalike_m.mean()
            change_m = simulation.without_m - simulation.with_m
            correlation += float(np.nansum(change_m * lookalike_m))
        sign = -1.0 if correlation < 0.0 else 1.0
        comparisons[finding.effect] = tuple(
            replace(simulation, lookalike_m=sign * simulation.lookalike_m)
            for simulation in simulations
        )
    return comparisons


def _simulate(axis: AxisModel, name: str, trace: Trace, fit: TangentFit) -> EffectSimulation:
    rows, with_m, parts_m, totals_m = fit
    effect = effect_named(name)
    # Contribution of the extension of the model, minus its mean.
    without = effect.without(axis, trace.recording)
    extension_m = np.zeros(len(trace.time_s))
    if without is not None:
        part_m = trace.modelled_m - simulate_recording(without, trace.recording)
        extension_m = part_m - np.nanmean(part_m)
    if effect.shows.kind == "spectrum":
        rows = np.flatnonzero(np.isfinite(trace.modelled_m))
        linear_m = totals_m[name][rows] if name in totals_m else np.zeros(len(rows))
        part_m = linear_m + extension_m[rows]
        with_m = trace.residual_m[rows] - linear_m
    else:
        part_m = parts_m[name] if name in parts_m else extension_m[rows]
    return EffectSimulation(
        trace=trace,
        rows=rows,
        without_m=with_m + part_m,
        with_m=with_m,
        lookalike_m=_lookalike(effect, axis, trace, rms(part_m))[rows],
    )


def _fit_tangents(
    axis: AxisModel, traces: Sequence[Trace], missing: Sequence[Finding], stroke_m: float
) -> list[TangentFit]:
    """Fit the tangents of all effects that the model lacks to its residual in each recording."""
    finite = [np.flatnonzero(np.isfinite(trace.modelled_m)) for trace in traces]
    rows = [np.asarray(samples[rows_of(len(samples), ROWS)]) for samples in finite]
    residuals_m = [trace.residual_m[k] for trace, k in zip(traces, rows, strict=True)]
    suspects = [(f, suspect_of(f, stroke_m)) for f in missing]
    pairs = [(f, suspect) for f, suspect in suspects if suspect is not None]
    if not pairs:
        return [(k, residual_m, {}, {}) for k, residual_m in zip(rows, residuals_m, strict=True)]
    drives = [
        replace(driven_recording(axis, trace.recording), rows=k)
        for trace, k in zip(traces, rows, strict=True)
    ]
    null = basis_of(
        null_columns(drives, lag=not any(suspect.tangent.lags for _, suspect in pairs))
    )
    scales = [scale_of(suspect, drives) for _, suspect in pairs]
    blocks = [
        block_of(suspect.tangent, scale, drives)
        for (_, suspect), scale in zip(pairs, scales, strict=True)
    ]
    free = [block - null @ (null.T @ block) for block in blocks]
    residual_m = np.concatenate(residuals_m)
    residual_m = residual_m - null @ (null.T @ residual_m)
    columns = np.hstack(free)
    size = np.maximum(np.linalg.norm(columns, axis=0), 1e-30)
    strength = np.linalg.lstsq(columns / size, residual_m, rcond=1e-9)[0] / size
    shares = np.split(strength, np.cumsum([block.shape[1] for block in free])[:-1])
    totals = [block @ share for block, share in zip(free, shares, strict=True)]
    cuts = np.cumsum([len(k) for k in rows])[:-1]
    remaining_m = np.split(residual_m - np.sum(totals, axis=0), cuts)
    split = [np.split(total, cuts) for total in totals]
    fits: list[TangentFit] = []
    for k, drive in enumerate(drives):
        totals_m = {}
        for (f, suspect), scale, share in zip(pairs, scales, shares, strict=True):
            columns = suspect.tangent.columns(drive, scale)
            width = columns.shape[1]
            start = k * width if suspect.tangent.per_drive else 0
            totals_m[f.effect] = np.asarray(columns @ share[start : start + width])
        parts_m = {f.effect: part[k] for (f, _), part in zip(pairs, split, strict=True)}
        fits.append((rows[k], remaining_m[k], parts_m, totals_m))
    return fits


def _lookalike(effect: Effect, axis: AxisModel, trace: Trace, size_m: float) -> Array:
    """Return the residual of a healthy stage with this effect of this size."""
    measured_m = trace.recording.displacement_m(axis.axis)
    healthy_m = np.where(np.isfinite(trace.modelled_m), trace.modelled_m, measured_m)
    channels = tuple(
        Channel(quantity=c.quantity, axis=c.axis, values=healthy_m, label=c.label)
        if c.quantity is Quantity.DISPLACEMENT and c.axis == axis.axis
        else c
        for c in trace.recording.channels
    )
    healthy = replace(trace.recording, channels=channels, axis=axis.axis)
    share = size_m / max(float(np.ptp(healthy_m)), 1e-30)
    faulty_m = healthy_m
    if share > MIN_SHARE:
        faulty_m = effect.inject(healthy, share).displacement_m(axis.axis)
    count = min(len(faulty_m), len(healthy_m))
    change_m = np.zeros(len(healthy_m))
    change_m[:count] = faulty_m[:count] - healthy_m[:count]
    noise = np.random.default_rng(len(healthy_m)).standard_normal(len(healthy_m))
    return np.asarray(change_m - change_m.mean() + axis.quality.noise_rms_m * noise)
