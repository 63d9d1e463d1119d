"""Parameter vector of the joint fit: hysteresis, then extensions.

Recordings as the joint fit sees them: pieces, the rows that count, the blocks they form.

Rows lie at no one distance, so that no hum hides between them. Blocks are stretches of several
seconds, or sixths of a short piece. Of the first block of each piece, every other quarter is never
left out: nothing else tells the memory and the zero with which the piece begins.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.forward import Forward, Run
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Scaled,
    operator_of,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.pieces import Piece, Rig, Scales, pieces_of
from piezoid.identification.hysteresis.unit_scaling import envelope_stretch
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.simulation import where_of
from piezoid.identification.step_rows import rows_after_steps
from piezoid.numerics.arrays import Array, Samples, spread_rows
from piezoid.operators.dead_zone import LINEAR, from_slopes
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

ROWS = 12_000  # of all pieces together
FOLDS = 5
BLOCKS = 6, 15  # of a piece, at least and at most
BLOCK_s = 4.0
NEVER_OUT = -1  # fold number of blocks that are always used for training


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One piece with its rows.

    piece  in scaled units, behind the declared amplifier
    where  the same for extensions
    samples  (rows,)  that are fitted
    fold   (rows,)  in which fold each is left out, NEVER_OUT where in none
    start  how the model says it began, None where the model does not know it
    """

    piece: Piece
    where: Where
    samples: Samples
    fold: Samples
    start: PieceStart | None


def scales_from(model: AxisModel) -> Scales:
    """Return the scales in which the numbers of a fitted model are of order one."""
    hysteresis = model.hysteresis
    knots, bends = hysteresis.envelope.threshold, hysteresis.envelope.zero
    low, high = model.voltage_V
    # The kinks of an envelope stand at even places of the scaled drive.
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
    """Cut recordings into parts, with the fitted starts of those that the model contains.

    samples     that may be fitted, for each piece; None: thinned evenly
    extensions  whose ringing no sample resolves is left out behind steps
    """
    pieces = pieces_of(recordings, model.axis, scales_from(model), model.rig)
    share = max(ROWS // len(pieces), 50)
    starts: list[list[PieceStart]] = []
    for number, recording in enumerate(recordings):
        count = sum(piece.recording == number for piece in pieces)
        of_recording = [start for start in model.starts if start.recording == recording.name]
        starts.append(of_recording if len(of_recording) == count else [])
    parts = []
    for number, piece in enumerate(pieces):
        start = starts[piece.recording].pop(0) if starts[piece.recording] else None
        if start is not None:
            piece = replace(piece, first=start.first, last=start.last)
        rows = slice(piece.begin, piece.begin + len(piece.drive))
        where = where_of(recordings[piece.recording], model.axis, rows)
        if samples is None:
            sample = piece.first + spread_rows(piece.rows, share)
        else:
            sample = samples[number]
        sample = sample[(sample >= piece.first) & (sample < piece.last)]
        ringing = rows_after_steps(piece.drive, piece.sampling_rate_Hz, extensions)
        sample = np.setdiff1d(sample, np.concatenate([piece.invalid, ringing]))
        # Blocks of several seconds; of the first every other quarter is never left out.
        duration_s = piece.rows / piece.sampling_rate_Hz
        blocks = int(np.clip(duration_s / BLOCK_s, *BLOCKS))
        quarter = (sample - piece.first) * blocks * 4 // piece.rows
        first = np.where(quarter % 2 == 0, NEVER_OUT, (quarter + number) % FOLDS)
        fold = np.where(quarter < 4, first, (quarter // 4 + number) % FOLDS)
        parts.append(Part(piece=piece, where=where, samples=sample, fold=fold, start=start))
    return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One point of the search.

    coordinates  what the first numbers mean
    theta        (total,)  as in the fit of the hysteresis alone
    extensions   with their own numbers, in the order in which they act
    scales, rig  as the parts were scaled
    fixed        slices of the vector that are not fitted
    """

    coordinates: Coordinates
    theta: Array
    extensions: tuple[Extension, ...]
    scales: Scales
    rig: Rig
    fixed: tuple[slice, ...] = ()

    @cached_property
    def operator(self) -> Scaled:
        """Return the operator."""
        return operator_of(self.theta, self.coordinates)

    @cached_property
    def forward(self) -> Forward:
        """Return the model."""
        return Forward(
            operator=self.operator,
            lag=self.coordinates.shape.lag,
            lag_s=self.operator.lag_s,
            sensor_Hz=self.rig.sensor_bandwidth_Hz,
            extensions=self.extensions,
            scales=self.scales,
        )

    def run(self, index: int, part: Part) -> Run:
        """Return one part from end to end."""
        zero = float(self.theta[self.coordinates.offset_slice(index)][0])
        return Run(
            forward=self.forward,
            command=part.piece.drive,
            memory_slope=self.theta[self.coordinates.memory_slice(index)],
            zero_m=part.piece.centre_m + self.scales.displacement_m * zero,
            centre_m=part.piece.centre_m,
            where=part.where,
        )

    @cached_property
    def slices(self) -> tuple[slice, ...]:
        """Return the slice of each extension in the vector."""
        edges = [len(self.theta)]
        for extension in self.extensions:
            edges.append(edges[-1] + len(extension.free().value))
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    @property
    def vector(self) -> Array:
        """Return all numbers."""
        return np.concatenate([self.theta, *(e.free().value for e in self.extensions)])

    def bounds(self, longest_lag_s: float) -> tuple[Array, Array]:
        """Return lower and upper bounds of all numbers.

        Thresholds may go beyond the reach of the drive: a play there rests, and bounding the sum
        of all gaps would bend every step.
        """
        lower, upper = self.coordinates.bounds(longest_lag_s)
        frees = [e.free() for e in self.extensions]
        lower = np.concatenate([lower, *(f.lower for f in frees)])
        upper = np.concatenate([upper, *(f.upper for f in frees)])
        for numbers in self.fixed:
            lower[numbers] = upper[numbers] = self.vector[numbers]
        return lower, upper

    def at(self, vector: Array) -> "State":
        """Return the point with these numbers."""
        theta = vector[: len(self.theta)]
        extensions = tuple(
            extension.moved_to(vector[numbers])
            for extension, numbers in zip(self.extensions, self.slices, strict=True)
        )
        return replace(self, theta=theta, extensions=extensions)


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Parts of the hysteresis that a joint fit may use.

    operator  weights, thresholds, lag and what extends the model already are fitted; False: only
              memory, zero and new extensions
    lag     the model's own lag, fitted
    memory  a memory of its own for every piece; False: what a drive cycled over its range leaves
    bends   kinks of the envelope on each side of its middle; None: as many as the model has
    """

    operator: bool = True
    lag: bool = True
    memory: bool = True
    bends: int | None = None


def state_of(
    model: AxisModel,
    parts: Sequence[Part],
    extensions: Sequence[Extension],
    structure: Structure,
) -> State:
    """Return the parameter vector of a model with extensions."""
    scales = scales_from(model)
    operator = _scaled(model, scales, keep_lag=structure.lag)
    if structure.bends is not None and structure.bends != operator.envelope.zero:
        operator = with_flat_envelope(operator, structure.bends)
    shape = operator.shape(model.lag.kind if structure.lag else "none")
    coordinates = Coordinates(shape=shape, offsets=(1,) * len(parts))
    theta = vector_of(operator, coordinates)
    stretch_V = envelope_stretch(operator) * scales.voltage_V
    for index, part in enumerate(parts):
        memory = coordinates.memory_slice(index)
        if part.start is not None:
            zero_m = float(part.start.zero_m.mean()) - part.piece.centre_m
            theta[coordinates.offset_slice(index)] = zero_m / scales.displacement_m
            slopes = np.diff(part.start.memory_V / stretch_V) / operator.gap
            theta[memory] = np.clip(slopes, -1.0, 1.0)
        if not structure.memory:  # after a drive that went down, up and then to its start
            turns = np.array([0.0, -1.0, 1.0, float(part.piece.drive[0])])
            inner = operator.envelope.run(turns)
            states = play_columns(inner, operator.threshold, np.zeros(len(operator.gap)))[1]
            theta[memory] = np.diff(states, prepend=inner[-1]) / operator.gap
    state = State(
        coordinates=coordinates,
        theta=theta,
        extensions=in_order(extensions),
        scales=scales,
        rig=model.rig,
    )
    fixed: list[slice] = []
    if not structure.operator:
        fitted = [any(e is extension for extension in model.extensions) for e in state.extensions]
        fixed += [numbers for numbers, is_old in zip(state.slices, fitted, strict=True) if is_old]
        fixed.append(slice(0, coordinates.shared))
    if not structure.memory:
        fixed += [coordinates.memory_slice(k) for k in range(len(parts))]
    return replace(state, fixed=tuple(fixed))


def _scaled(model: AxisModel, scales: Scales, *, keep_lag: bool) -> Scaled:
    """Return a model's operator in scaled units, central slopes 1: the inverse of ``physical``."""
    hysteresis, stroke_m = model.hysteresis, abs(scales.displacement_m)
    envelope, zones = hysteresis.envelope, hysteresis.dead_zones
    stretch = float(envelope.slope[envelope.zero])
    centre = float(zones.slope[zones.zero])
    threshold = hysteresis.plays.threshold / (stretch * scales.voltage_V)
    return Scaled(
        gap=np.diff(threshold),
        threshold=threshold[1:],
        weight=hysteresis.plays.weight * (centre * stretch * scales.voltage_V / stroke_m),
        knot=zones.threshold * (centre / stroke_m),
        slope=zones.slope / centre,
        zero=zones.zero,
        lag_s=model.lag.time_s if keep_lag else 0.0,
        envelope=from_slopes(envelope.threshold / scales.voltage_V, envelope.slope / stretch)
        if envelope.zero > 0
        else LINEAR,
    )
