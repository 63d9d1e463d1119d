"""fit_extended: joint refit of an axis model and its extensions, with cross-validation.

It is the search of the hysteresis fit, with the numbers of extensions as further parameters. The
refit without a fold starts from the fit to all rows.

Rows are not equidistant, so that no hum is aliased to zero frequency. Blocks are several seconds
long, or sixths of a short piece. Every other quarter of the first block of each piece is never
left out, because only the first rows determine the initial state of the piece.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.linear_mode import rows_after_steps
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Structure,
    envelope_stretch,
    shape_of,
    to_scaled_units,
    to_si_units,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.gauss_newton import Task, minimise, residuals
from piezoid.identification.hysteresis.pieces import (
    Piece,
    PieceStart,
    Scales,
    longest_lag_s,
    pieces_of,
)
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import BLOCKS, FOLDS, IN_SAMPLE, NEVER_OUT, with_noise_bound
from piezoid.identification.simulation import fitted_pieces
from piezoid.numerics.arrays import Array, Samples, spread_rows
from piezoid.numerics.levenberg_marquardt import Rule
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

MAX_ROWS = 12_000  # of all pieces together
MIN_BLOCKS, MAX_BLOCKS = 6, 15  # of a piece
BLOCK_s = 4.0
MAX_STEPS = 10
RULE = Rule(tolerance=1e-4, tries=8, damping=1e-4)
# Of a fit without a fold: with two or three, held-out errors differ by 0.4 to 3.4 %.
FOLD_STEPS = 1
FULL_STRUCTURE = Structure()


@dataclass(frozen=True, kw_only=True, eq=False)
class Extended:
    """Result of a joint fit.

    model           fitted axis with its extensions
    rms_m           residual at all rows
    held_out_rms_m  error at left-out rows
    held_m          (rows,)  error at left-out rows
    spread          standard errors of the numbers of each extension, from leaving out folds
    """

    model: AxisModel
    rms_m: float
    held_out_rms_m: float
    held_m: Array
    spread: tuple[Array, ...]


def fit_extended(
    model: AxisModel,
    recordings: Sequence[Recording],
    extensions: Sequence[Extension] = (),
    *,
    further_starts: Sequence[AxisModel] = (),
    structure: Structure = FULL_STRUCTURE,
    samples: Sequence[Samples] | None = None,
    ringing: Sequence[Extension] = (),
    steps: int = MAX_STEPS,
) -> Extended:
    """Refit weights, thresholds, memory and zero of an axis together with extensions.

        min over all parameters of sum over rows of (simulated - measured)^2

    model           fitted axis: start of the search, with its numbers of plays and dead zones
    recordings      of this axis; recordings that the model does not contain start with all
                    plays at the first drive
    extensions      with start values near the true ones
    further_starts  further models to start from, because thresholds have many local minima; only
                    the closest fit is returned and cross-validated
    structure       components of the hysteresis that are fitted
    samples         samples that may be fitted, for each piece; None: all, thinned evenly
    ringing         further modes whose unresolved ringing is excluded, as that of ``extensions``:
                    errors of several fits are comparable only over the same samples

    Every piece has one constant zero; ``ThermalDrift`` represents slow motion. The held-out error
    is that of blocks of several seconds that are excluded from the fit of all parameters, but not
    from the simulation. A parameter that the rows do not determine keeps its start value, and a
    mode that starts more than its width from the true frequency is not found.
    """
    searches = []
    for start in (model, *further_starts):
        parts = parts_of(start, recordings, samples, (*extensions, *ringing))
        task, theta = task_of(start, parts, extensions, structure)
        fit = minimise(theta, task, iterations=steps, rule=RULE)
        searches.append((start, parts, fit, fit.rms * abs(task.scales.displacement_m)))
    start, parts, fit, rms_m = min(searches, key=lambda search: search[3])
    refits: list[Array] = []
    errors: list[Array] = []
    for fold in range(FOLDS):
        training = [part.samples[part.fold != fold] for part in parts]
        held_out = [part.samples[part.fold == fold] for part in parts]
        refit = minimise(
            fit.theta, replace(fit.task, samples=training), iterations=FOLD_STEPS, rule=RULE
        )
        refits.append(refit.theta)
        errors += residuals(refit.theta, replace(fit.task, samples=held_out))
    scales, coordinates = fit.task.scales, fit.task.coordinates
    held_m = np.concatenate(errors) * abs(scales.displacement_m)
    held_out_rms_m = float(np.sqrt(np.mean(held_m**2)))
    # Standard errors from leaving out folds: (F - 1) / sqrt(F) times their scatter.
    std = np.std(refits, axis=0, ddof=1) * (FOLDS - 1) / np.sqrt(FOLDS)
    spread = tuple(std[numbers] for numbers in coordinates.extension_slices)

    operator, starts = fit.operator, fit.starts(scales)
    zero_m = float(np.mean([s.zero_m.mean() for s in starts]))
    uncertainty, lag_std = start.uncertainty, std[coordinates.slices["lag"]]
    if len(lag_std):  # the previous fit may have lacked a mode
        uncertainty = uncertainty.updated("lag_s", operator.lag_s, float(lag_std[0]))
    is_tested = start.quality.is_tested
    quality = replace(
        start.quality,
        rms_m=rms_m,
        held_out_rms_m=held_out_rms_m if is_tested else rms_m,
        held_out_kind=BLOCKS if is_tested else IN_SAMPLE,
        rows=fit.task.rows,
        effective_parameters=float(len(fit.theta)),
        converged=fit.converged,
    )
    remainder_m = float(np.quantile(np.abs(held_m), 0.999))
    extended = replace(
        start,
        hysteresis=to_si_units(operator, scales, zero_m),
        lag=Lag(kind=fit.shape.lag, time_s=operator.lag_s),
        extensions=tuple(
            replace(extension, std=tuple(of_numbers.tolist()))
            for extension, of_numbers in zip(
                fit.task.extensions_at(fit.theta), spread, strict=True
            )
        ),
        starts=starts,
        uncertainty=uncertainty,
        quality=with_noise_bound(quality),
        certificate=replace(start.certificate, remainder_m=remainder_m),
    )
    return Extended(
        model=extended,
        rms_m=rms_m,
        held_out_rms_m=held_out_rms_m,
        held_m=held_m,
        spread=spread,
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One piece with its rows.

    piece    in scaled units, behind the declared amplifier
    samples  (rows,)  of the piece that are fitted
    fold     (rows,)  fold that leaves the row out, or ``NEVER_OUT``
    start    fitted start in the model, or None
    """

    piece: Piece
    samples: Samples
    fold: Samples
    start: PieceStart | None


def parts_of(
    model: AxisModel,
    recordings: Sequence[Recording],
    samples: Sequence[Samples] | None = None,
    extensions: Sequence[Extension] = (),
) -> list[Part]:
    """Select the rows of all pieces, with the fitted starts of recordings in the model.

    samples     that may be fitted, for each piece; None: thinned evenly
    extensions  modes among them exclude samples in which their ringing after steps is unresolved
    """
    pieces = pieces_of(recordings, model.axis, scales_from(model), model.rig)
    max_rows = max(MAX_ROWS // len(pieces), 50)
    starts = {
        (number, fitted.samples.start): fitted.start
        for number, recording in enumerate(recordings)
        for fitted in fitted_pieces(model, recording)
    }
    parts = []
    for number, piece in enumerate(pieces):
        start = starts.get((piece.recording, piece.begin))
        if start is not None:
            piece = replace(piece, first=start.first, last=start.last)
        if samples is None:
            sample = piece.first + spread_rows(piece.rows, max_rows)
        else:
            sample = samples[number]
        sample = sample[(sample >= piece.first) & (sample < piece.last)]
        ringing = rows_after_steps(piece.drive, piece.sampling_rate_Hz, extensions)
        sample = np.setdiff1d(sample, np.concatenate([piece.invalid, ringing]))
        duration_s = piece.rows / piece.sampling_rate_Hz
        blocks = int(np.clip(duration_s / BLOCK_s, MIN_BLOCKS, MAX_BLOCKS))
        quarter = (sample - piece.first) * blocks * 4 // piece.rows
        first = np.where(quarter % 2 == 0, NEVER_OUT, (quarter + number) % FOLDS)
        fold = np.where(quarter < 4, first, (quarter // 4 + number) % FOLDS)
        parts.append(Part(piece=piece, samples=sample, fold=fold, start=start))
    return parts


def task_of(
    model: AxisModel,
    parts: Sequence[Part],
    extensions: Sequence[Extension],
    structure: Structure,
) -> tuple[Task, Array]:
    """Return the least-squares problem of a model with extensions, and its start.

    Thresholds may exceed the range of the drive, where a play does not move: a bound on the sum of
    all gaps would change the direction of every step.
    """
    scales = scales_from(model)
    operator = to_scaled_units(
        model.hysteresis, scales, model.lag.time_s if structure.lag else 0.0
    )
    if structure.bends is not None and structure.bends != operator.envelope.zero:
        operator = with_flat_envelope(operator, structure.bends)
    ordered = in_order(extensions)
    frees = [extension.free() for extension in ordered]
    coordinates = Coordinates(
        shape=shape_of(operator, model.lag.kind if structure.lag else "none"),
        offsets=(1,) * len(parts),
        numbers=tuple(len(free.value) for free in frees),
    )
    theta = vector_of(operator, coordinates)
    stretch_V = envelope_stretch(operator) * scales.voltage_V
    for index, part in enumerate(parts):
        memory = coordinates.memory_slice(index)
        if part.start is not None:
            zero_m = float(part.start.zero_m.mean()) - part.piece.centre_m
            theta[coordinates.offset_slice(index)] = zero_m / scales.displacement_m
            slopes = np.diff(part.start.memory_V / stretch_V) / operator.gap
            theta[memory] = np.clip(slopes, -1.0, 1.0)
        if not structure.memory:  # after a drive from the middle down, up and to its first sample
            turns = np.array([0.0, -1.0, 1.0, float(part.piece.drive[0])])
            inner = operator.envelope.run(turns)
            states = play_columns(inner, operator.threshold, np.zeros(len(operator.gap)))[1]
            theta[memory] = np.diff(states, prepend=inner[-1]) / operator.gap
    fixed: list[slice] = []
    if not structure.operator:
        fixed.append(slice(0, coordinates.shared))
    if not structure.memory:
        fixed += [coordinates.memory_slice(index) for index in range(len(parts))]
    for extension, free, numbers in zip(ordered, frees, coordinates.extension_slices, strict=True):
        theta[numbers] = free.value
        is_previous = any(extension is previous for previous in model.extensions)
        if is_previous and not structure.operator:
            fixed.append(numbers)
    task = Task(
        pieces=[part.piece for part in parts],
        coordinates=coordinates,
        sensor_pole_Hz=model.rig.sensor_bandwidth_Hz,
        samples=[part.samples for part in parts],
        longest_lag_s=longest_lag_s([part.piece for part in parts]),
        fixed=tuple(fixed),
        extensions=ordered,
        scales=scales,
    )
    return task, theta


def scales_from(model: AxisModel) -> Scales:
    """Return the scales in which the parameters of a fitted model are of order one."""
    hysteresis = model.hysteresis
    knots, bends = hysteresis.envelope.threshold, hysteresis.envelope.zero
    low, high = model.voltage_V
    # The kinks of an envelope are equidistant in the scaled drive.
    half_V = float(knots[-1]) * (bends + 1) / bends if bends else (high - low) / 2
    return Scales(
        voltage_V=half_V,
        voltage_offset_V=hysteresis.voltage_offset_V,
        displacement_m=model.polarity * model.quality.range_m / 2,
    )
