"""Residuals without and with one effect, and the look-alike: a healthy stage with that effect.

If the model contains the effect as an extension, the residual without the effect is the
measurement minus the model without that extension. For all other effects the tangent columns are
fitted to the residual together with the Jacobian of the model. The residual without such an effect
is then the remaining residual plus the contribution of the effect.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, Diagnosis, Finding
from piezoid.diagnosis.drive_response import (
    DriveResponse,
    driven_recording,
    null_columns,
    rows_of,
)
from piezoid.diagnosis.effect import Tangent
from piezoid.diagnosis.effects import effect_named
from piezoid.diagnosis.planning.open_questions import suspect_of
from piezoid.diagnosis.planning.separation import basis_of, block_of, scale_of
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Channel, Quantity
from piezoid_reports.traces import Trace, rms

ROWS = 3000  # of each recording
MIN_SHARE = 1e-6  # of the stroke: a smaller effect is not simulated
MAX_RECORDINGS = 6  # with the largest residuals


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
    fitted = _fit_tangents(axis, worst, missing, diagnosis.stroke_m)
    comparisons = {}
    for finding in effects:
        simulations = [
            _simulate(axis, finding, trace, fit) for trace, fit in zip(worst, fitted, strict=True)
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


def _simulate(
    axis: AxisModel, finding: Finding, trace: Trace, fit: "TangentFit"
) -> EffectSimulation:
    if effect_named(finding.effect).shows.kind == "spectrum":
        rows = np.flatnonzero(np.isfinite(trace.modelled_m))
        total_m = fit.total_m.get(finding.effect)
        linear_m = np.zeros(len(rows)) if total_m is None else total_m[rows]
        part_m = linear_m + extension_part(axis, finding.effect, trace)[rows]
        with_m = trace.residual_m[rows] - linear_m
    else:
        rows, with_m = fit.rows, fit.with_m
        tangent_m = fit.part_m.get(finding.effect)
        part_m = (
            extension_part(axis, finding.effect, trace)[rows] if tangent_m is None else tangent_m
        )
    return EffectSimulation(
        trace=trace,
        rows=rows,
        without_m=with_m + part_m,
        with_m=with_m,
        lookalike_m=_lookalike(finding.effect, axis, trace, rms(part_m))[rows],
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class TangentFit:
    """Tangents of the effects that the model lacks, fitted to one recording.

    rows     indices of the samples
    with_m   (rows,)  residual with every tangent fitted
    part_m   (rows,)  by effect, its contribution that the parameters of the model cannot imitate
    total_m  (samples,)  by effect, its total contribution
    """

    rows: NDArray[np.int_]
    with_m: Array
    part_m: Mapping[str, Array] = field(default_factory=dict)
    total_m: Mapping[str, Array] = field(default_factory=dict)


def _fit_tangents(
    axis: AxisModel, traces: Sequence[Trace], missing: Sequence[Finding], stroke_m: float
) -> list[TangentFit]:
    """Fit the tangents of all effects that the model lacks to its residual."""
    finite = [np.flatnonzero(np.isfinite(trace.modelled_m)) for trace in traces]
    rows = [np.asarray(samples[rows_of(len(samples), ROWS)]) for samples in finite]
    residuals_m = [trace.residual_m[k] for trace, k in zip(traces, rows, strict=True)]
    suspects = [(f, suspect_of(f, stroke_m)) for f in missing]
    pairs = [(f, suspect) for f, suspect in suspects if suspect is not None]
    if not pairs:
        return [TangentFit(rows=k, with_m=m) for k, m in zip(rows, residuals_m, strict=True)]
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
    return [
        TangentFit(
            rows=rows[k],
            with_m=remaining_m[k],
            part_m={f.effect: split[j][k] for j, (f, _) in enumerate(pairs)},
            total_m={
                f.effect: _tangent_part(drive, suspect.tangent, scales[j], shares[j], k)
                for j, (f, suspect) in enumerate(pairs)
            },
        )
        for k, drive in enumerate(drives)
    ]


def _tangent_part(
    drive: DriveResponse, tangent: Tangent, scale: float, share: Array, k: int
) -> Array:
    columns = tangent.columns(drive, scale)
    width = columns.shape[1]
    coefficients = share[k * width : (k + 1) * width] if tangent.per_drive else share[:width]
    return np.asarray(columns @ coefficients)


def _lookalike(name: str, axis: AxisModel, trace: Trace, size_m: float) -> Array:
    """Return the residual of a healthy stage with this effect of this size."""
    effect = effect_named(name)
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


def extension_part(axis: AxisModel, effect: str, trace: Trace) -> Array:
    """Return the contribution of an effect to the simulation, minus its mean; 0 without one."""
    without = effect_named(effect).without(axis, trace.recording)
    if without is None:
        return np.zeros(len(trace.time_s))
    part_m = trace.modelled_m - simulate_recording(without, trace.recording)
    return np.asarray(part_m - np.nanmean(part_m))
