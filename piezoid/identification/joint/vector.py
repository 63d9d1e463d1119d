"""Rows, blocks and start of the joint fit of a model and its extensions.

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
    envelope_stretch,
    to_scaled_units,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.gauss_newton import Task
from piezoid.identification.hysteresis.pieces import (
    Piece,
    PieceStart,
    Scales,
    longest_lag_s,
    pieces_of,
)
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import FOLDS, NEVER_OUT
from piezoid.identification.simulation import fitted_pieces
from piezoid.numerics.arrays import Array, Samples, spread_rows
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

MAX_ROWS = 12_000  # of all pieces together
MIN_BLOCKS, MAX_BLOCKS = 6, 15  # of a piece
BLOCK_s = 4.0


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


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Components of the hysteresis that a joint fit uses.

    operator  True: weights, thresholds, lag and previous extensions are fitted; False: only
              memory, zero and new extensions
    lag       whether the model has a lag, which is then fitted
    memory    True: the memory of every piece is fitted; False: it is that after a full cycle
    bends     kinks of the envelope on each side of its middle; None: as in the model
    """

    operator: bool = True
    lag: bool = True
    memory: bool = True
    bends: int | None = None


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
        shape=operator.shape(model.lag.kind if structure.lag else "none"),
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
