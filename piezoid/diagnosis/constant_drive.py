"""Diagnose recordings at constant drive: drift, jumps, hum, other axes, and an unknown line.

    y = c + drift(t) + jump(t - t0) + sum_h a_h cos(2 pi h f t) + b_h sin(2 pi h f t)
        + a cos(2 pi f1 t) + b sin(2 pi f1 t) + sum_j g_j u_j + noise

Such recordings do not show hysteresis. The model is linear except for the frequency f of the grid,
the instant t0 and the frequency f1 of the line. Each cause is evaluated by its reduction of the
error on left-out blocks of time, beside the other causes. If the logarithm of the time since the
beginning is as good as a cubic, drift cannot be separated from creep after earlier motion.

Source: Bendat & Piersol for lines beside a trend; Arlot & Celisse (2010) on blocks.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import erfc, sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import (
    FOLDS,
    SAME_ERROR,
    blocks_of,
    gain_on_blocks,
    held_out_residual,
    relative_scatter,
)
from piezoid.diagnosis.budget import RemainingErrors, with_budget
from piezoid.diagnosis.candidate import MINIMUM_Z
from piezoid.diagnosis.coordinate_scores import strongest_peaks
from piezoid.diagnosis.diagnosis import (
    NOT_EXCITED,
    SOMETHING_ELSE,
    Diagnosis,
    Finding,
    HeldOut,
    NotDetected,
    Size,
    Unexplained,
    fraction_explained,
)
from piezoid.diagnosis.effect import ConstantDriveData, Effect
from piezoid.diagnosis.effects import effect_named, every_effect
from piezoid.diagnosis.residual_coordinates import NEXT_EXPERIMENTS, coordinate_profile
from piezoid.diagnosis.segments import Places
from piezoid.diagnosis.signals import GRIDS_Hz, cubic, peak_Hz, waves
from piezoid.formatting import significant, with_unit
from piezoid.identification.hysteresis.sensor_noise import noise_rms
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

DRIFT = "thermal_drift"  # the trend beside which all other causes are tested
JUMP, LINE = "jump", "line"  # not in the catalogue: findings of something else
MIN_GAIN = 0.01  # of the error
MIN_GAIN_JUMP = 0.05  # of the error: the best of all jumps reduces it by less at random
LINE_P = 1e-4  # p-value of an unknown line: there are thousands of frequencies to try
ROWS = 60_000  # of a recording: enough for a line of a ten-thousandth of the noise
LOG_SCALES = (0.003, 0.03, 0.1)  # of the recording: scales of a logarithm of time
MIN_PERIODS = 4  # of a line in the recording


@dataclass(frozen=True, kw_only=True, eq=False)
class RestColumns:
    """Columns of all causes that may move a stage at constant drive.

    recording   name of the recording
    time_s      (rows,)
    y_m         (rows,)  readings about their mean
    columns     (rows, columns) by cause, each about its mean
    is_creep    whether a logarithm of time is as good as a cubic
    jump_s      instant of the jump, from the beginning of the recording
    line_Hz     frequency of the unknown line, 0 if there is none
    untestable  why the recording cannot show an effect, by the name of the effect
    """

    recording: str
    time_s: Array
    y_m: Array
    columns: Mapping[str, Array]
    is_creep: bool
    jump_s: float
    line_Hz: float = 0.0
    untestable: Mapping[str, str] = field(default_factory=dict)

    def residual(self, names: Iterable[str]) -> Array:
        """Return the residual of these causes on left-out blocks, (rows,)."""
        return held_out_residual(self.y_m, [self.columns[name] for name in names])

    def significant_gain(self, name: str, selected: Sequence[str]) -> float:
        """Return the gain of a cause beside selected causes; 0 if small or not significant."""
        gain, z = gain_on_blocks(self.residual(selected), self.residual([*selected, name]))
        min_gain = MIN_GAIN_JUMP if name == JUMP else MIN_GAIN
        return gain if gain >= min_gain and z >= MINIMUM_Z else 0.0


def diagnose_at_rest(recordings: Sequence[Recording], axis: str) -> Diagnosis:
    """Diagnose the displacement of a stage at constant drive.

    recordings  of one stage, each with the displacement of the axis

    The longest recording is diagnosed. Effects that need a drive are not tested.
    """
    recording = max(recordings, key=lambda r: r.duration_s)
    rows = np.setdiff1d(np.arange(recording.samples), recording.bridged)
    is_slow = recording.sampling_rate_Hz <= 2.0 * GRIDS_Hz[0]  # no line of the grid shows
    rows = rows[:: max(1, len(rows) // ROWS)] if is_slow else rows[:ROWS]
    readings, selected = _select(rest_columns(recording, axis, rows, every_effect()))
    final = readings.residual(selected)
    noise_m = noise_rms((readings.y_m, final))
    span_m = max(float(np.ptp(recording.displacement_m(axis))), 1e-30)
    before_m, after_m = (float(np.sqrt(np.mean(e**2))) for e in (readings.residual([]), final))
    findings = [_finding(name, readings, selected) for name in selected]
    # the residual beyond the noise, and the p-value of its highest line among all
    power_m2 = float(np.mean(final**2))
    above_m2 = max(power_m2 - noise_m**2, 0.0)
    line, p_value, _ = next(iter(strongest_peaks(_spectrum(final))), (0.0, 1.0, 0))
    unexplained = Unexplained(
        rms_m=sqrt(above_m2),
        share=above_m2 / max(power_m2, 1e-300),
        p_value=max(p_value, 1e-12),
        coordinate="frequency",
        gain=min(2.0 * line / max(power_m2 * len(final) ** 2, 1e-300), 1.0),
    )
    diagnosis = Diagnosis(
        axis=axis,
        stroke_m=span_m,
        baseline=HeldOut.of(before_m, span_m),
        final=HeldOut.of(after_m, span_m),
        envelope_rms_m=after_m,
        noise_floor_rms_m=noise_m,
        explained_fraction=fraction_explained(before_m, after_m, noise_m),
        unexplained=unexplained,
        findings=tuple(sorted(findings, key=lambda f: f.held_out_gain, reverse=True)),
        not_detected=tuple(
            _not_detected(effect, readings, after_m)
            for effect in every_effect()
            if effect.name not in selected
        ),
    )
    scatter = relative_scatter(final)
    errors = RemainingErrors(
        explained_m=after_m, wide_m=after_m, scatter=scatter, is_compared=False
    )
    return with_budget(diagnosis, errors)


def rest_columns(
    recording: Recording, axis: str, rows: Places, effects: Iterable[Effect]
) -> RestColumns:
    """Return the columns of every cause that is visible at constant drive.

    rows     (rows,)  samples that are used
    effects  all effects; each with ``at_rest`` adds columns
    """
    reading_m = recording.displacement_m(axis)[rows]
    time_s, y_m = rows / recording.sampling_rate_Hz, reading_m - reading_m.mean()
    elapsed_s, span_s = time_s - time_s[0], max(float(np.ptp(time_s)), 1e-30)
    polynomial = cubic(time_s)
    logarithms = np.column_stack([np.log1p(elapsed_s / (share * span_s)) for share in LOG_SCALES])

    def error(columns: Array) -> float:
        return float(np.mean(held_out_residual(y_m, [columns]) ** 2))

    polynomial_error = error(polynomial)
    drift = logarithms if error(logarithms) < polynomial_error else polynomial
    jump, jump_s = _jump(time_s, y_m, (polynomial, logarithms))
    data = ConstantDriveData(
        recording=recording,
        axis=axis,
        rows=rows,
        time_s=time_s,
        detrended_m=y_m - drift @ np.linalg.lstsq(drift, y_m, rcond=None)[0],
    )
    columns, untestable = {DRIFT: drift, JUMP: jump}, {}
    for effect in effects:
        added = effect.at_rest(data) if effect.at_rest is not None else None
        if isinstance(added, str):
            untestable[effect.name] = added
        elif added is not None:
            columns[effect.name] = added
    creep_error = min(error(logarithms[:, k : k + 1]) for k in range(len(LOG_SCALES)))
    return RestColumns(
        recording=recording.name,
        time_s=time_s,
        y_m=y_m,
        columns={name: values - values.mean(axis=0) for name, values in columns.items()},
        is_creep=creep_error <= SAME_ERROR**2 * polynomial_error,
        jump_s=jump_s,
        untestable=untestable,
    )


def _select(readings: RestColumns) -> tuple[RestColumns, list[str]]:
    """Select significant causes by forward selection, the largest gain first, then a line.

    A jump is tested first and beside drift, because drift explains half of any jump.

    Returns the columns, with those of a significant line, and the selected causes.
    """
    selected = [JUMP] if readings.significant_gain(JUMP, [DRIFT]) else []
    while True:
        remaining = [name for name in readings.columns if name not in (*selected, JUMP)]
        gains = {name: readings.significant_gain(name, selected) for name in remaining}
        best = max(remaining, key=lambda name: gains[name], default=DRIFT)
        if not gains.get(best):
            break
        selected.append(best)
    residual, time_s = readings.residual(selected), readings.time_s
    lines = strongest_peaks(_spectrum(residual))
    if not lines or lines[0][1] > LINE_P:
        return readings, selected
    per_s = (len(residual) - 1) / (len(residual) * float(np.ptp(time_s)))
    line_Hz = peak_Hz(residual, time_s, per_s * lines[0][2], per_s)
    columns = {**readings.columns, LINE: waves(time_s, [line_Hz])}
    with_line = replace(readings, columns=columns, line_Hz=line_Hz)
    if with_line.significant_gain(LINE, selected):
        return with_line, [*selected, LINE]
    return readings, selected


def _spectrum(residual: Array) -> Array:
    power = np.asarray(np.abs(np.fft.rfft(residual - residual.mean())) ** 2)
    power[:MIN_PERIODS] = 0.0
    return power


def _jump(time_s: Array, y: Array, drifts: Sequence[Array]) -> tuple[Array, float]:
    """Return the step column (rows, 1) with the smallest error beside drift, and its instant."""
    edge = max(len(y) // 50, 1)
    rows = np.arange(edge, len(y) - edge)
    smallest, first = np.inf, edge
    for drift in drifts:
        basis = np.linalg.qr(np.column_stack([np.ones(len(y)), drift]))[0]
        residual = y - basis @ (basis.T @ y)
        # the sums from each row to the end are the products with its step
        products = np.cumsum(basis[::-1], axis=0)[::-1][rows]
        power = np.maximum(len(y) - rows - (products**2).sum(axis=1), 1e-12)
        explained = np.cumsum(residual[::-1])[::-1][rows] ** 2 / power
        error = float(residual @ residual) - float(explained.max())
        if error < smallest:
            smallest, first = error, int(rows[np.argmax(explained)])
    step = (np.arange(len(y)) >= first).astype(np.float64)
    return step[:, None], float(time_s[first] - time_s[0])


def _finding(name: str, readings: RestColumns, selected: Sequence[str]) -> Finding:
    other_causes = [cause for cause in selected if cause != name]
    baseline, residual = readings.residual(other_causes), readings.residual([*other_causes, name])
    gain, z = gain_on_blocks(baseline, residual)
    design = np.column_stack([readings.columns[cause] for cause in (*other_causes, name)])
    width, fold = readings.columns[name].shape[1], blocks_of(len(readings.y_m)) % FOLDS
    value_m = _size_m(design, readings.y_m, width)
    sizes_m = [_size_m(design[fold != k], readings.y_m[fold != k], width) for k in range(FOLDS)]
    margin_m = 1.96 * float(np.std(sizes_m, ddof=1)) * (FOLDS - 1) / sqrt(FOLDS)
    finding = Finding(
        effect=name,
        held_out_gain=float(np.clip(gain, 0.0, 1.0)),
        held_out_rms_before_m=float(np.sqrt(np.mean(baseline**2))),
        held_out_rms_after_m=float(np.sqrt(np.mean(residual**2))),
        p_value=min(1.0, max(0.5 * erfc(z / sqrt(2.0)), 1e-12) * len(readings.columns)),
        rms_percent=100.0 * value_m / max(float(np.ptp(readings.y_m)), 1e-30),
        size=Size.of_rms(value_m, max(value_m - margin_m, 0.0), value_m + margin_m),
        not_separable_from=(),
        explanation="",
        next_experiment="",
        parameters={},
    )
    size = f"At rest it is {with_unit(value_m, 'm')} rms."
    if name in (JUMP, LINE):
        return _something_else(finding, readings, design, width, size)
    effect = effect_named(name)
    finding = replace(
        finding, explanation=f"{effect.summary} {size}", next_experiment=effect.experiment
    )
    if name != DRIFT or not readings.is_creep:
        return finding
    return replace(
        finding,
        explanation=f"{finding.explanation} It slows down as the logarithm of the time does: "
        "drift and creep after what the drive did before are not separable here.",
        next_experiment="Step to mid-range and hold the drive for ten times as long: creep goes "
        "on slowing down, thermal drift does not.",
        not_separable_from=effect.confounded,
    )


def _something_else(
    finding: Finding, readings: RestColumns, design: Array, width: int, size: str
) -> Finding:
    """Complete the finding of a jump or an unknown line, with its profile along time or phase.

    design  (rows, columns)  of all selected causes; the last ``width`` are those of the finding
    """
    centred = design - design.mean(axis=0)
    coefficient = np.linalg.lstsq(centred, readings.y_m, rcond=None)[0]
    curve_m = centred[:, -width:] @ coefficient[-width:]
    residual_m = readings.y_m - centred @ coefficient + curve_m
    if finding.effect == LINE:
        coordinate, parameters = "frequency", {"frequency_Hz": readings.line_Hz}
        cause = (
            f"a line at {significant(readings.line_Hz, 5)} Hz: the floor, a pump or another "
            f"instrument. {size}"
        )
        phase = (readings.time_s * readings.line_Hz) % 1.0
        profile = coordinate_profile(phase, residual_m, curve_m, unit="")
    else:
        jump_m, coordinate = float(coefficient[-1]), "time"
        parameters = {"instant_s": readings.jump_s, "jump_m": jump_m}
        cause = (
            f"one jump by {with_unit(jump_m, 'm')} at {with_unit(readings.jump_s, 's')}: the "
            "stage, its mount or the sensor."
        )
        profile = coordinate_profile(
            readings.time_s, residual_m, curve_m, unit="s", recording=readings.recording
        )
    return replace(
        finding,
        effect=SOMETHING_ELSE,
        explanation=f"No effect of the catalogue explains {cause}",
        next_experiment=NEXT_EXPERIMENTS[coordinate],
        parameters=parameters,
        coordinate=coordinate,
        seen=profile,
    )


def _size_m(design: Array, y_m: Array, width: int) -> float:
    """Return the rms of the contribution of the last columns to a fit of all."""
    centred = design - design.mean(axis=0)
    coefficient = np.linalg.lstsq(centred, y_m - y_m.mean(), rcond=None)[0]
    return float(np.std(centred[:, -width:] @ coefficient[-width:]))


def _not_detected(effect: Effect, readings: RestColumns, rms_m: float) -> NotDetected:
    bound_m = None
    reason = readings.untestable.get(effect.name, NOT_EXCITED)
    if effect.name in readings.columns:
        # of a sum of these columns in white noise, one-sided 95 %
        width = readings.columns[effect.name].shape[1]
        bound_m = rms_m * max(sqrt(2.0 * MIN_GAIN), 3.0 * sqrt(width / len(readings.y_m)))
        reason = f"not detected; {with_unit(bound_m, 'm')} rms would have been"
    return NotDetected(
        effect=effect.name,
        upper_bound_m=bound_m,
        detection_limit_m=bound_m,
        reason=reason,
        next_experiment=effect.experiment,
    )
