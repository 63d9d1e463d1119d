"""Parameter vector of the joint fit, and the rows and blocks to which it is fitted.

The vector contains the hysteresis, then the extensions. Rows are not equidistant, so that no hum
is aliased to zero frequency. Blocks are several seconds long, or sixths of a short piece. Every
other quarter of the first block of each piece is never left out, because only the first rows
determine the initial state of the piece.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from piezoid.identification.extensions import in_order
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.extensions.linear_mode import rows_after_steps
from piezoid.identification.forward import Forward, Run
from piezoid.identification.hysteresis.coordinates import (
    Coordinates,
    Scaled,
    envelope_stretch,
    operator_of,
    vector_of,
    with_flat_envelope,
)
from piezoid.identification.hysteresis.pieces import Piece, PieceStart, Rig, Scales, pieces_of
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import where_of
from piezoid.numerics.arrays import Array, Samples, spread_rows
from piezoid.operators.dead_zone import LINEAR, from_slopes
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording

MAX_ROWS = 12_000  # of all pieces together
FOLDS = 5
MIN_BLOCKS, MAX_BLOCKS = 6, 15  # of a piece
BLOCK_s = 4.0
NEVER_OUT = -1  # fold number of blocks that are always used for training


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """One piece with its rows.

    piece    in scaled units, behind the declared amplifier
    where    location of the piece, for extensions
    samples  (rows,)  of the piece that are fitted
    fold     (rows,)  fold that leaves the row out, or ``NEVER_OUT``
    start    fitted start in the model, or None
    """

    piece: Piece
    where: Where
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
        parts.append(Part(piece=piece, where=where, samples=sample, fold=fold, start=start))
    return parts


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """One point of the search.

    coordinates  parametrisation of the hysteresis
    theta        (total,)  parameters of the hysteresis, as in its own fit
    extensions   in the order in which they act
    scales, rig  of the parts
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
        """The hysteresis operator, scaled."""
        return operator_of(self.theta, self.coordinates)

    @cached_property
    def forward(self) -> Forward:
        """The forward model."""
        return Forward(
            operator=self.operator,
            lag=self.coordinates.shape.lag,
            lag_s=self.operator.lag_s,
            sensor_Hz=self.rig.sensor_bandwidth_Hz,
            extensions=self.extensions,
            scales=self.scales,
        )

    def run(self, index: int, part: Part) -> Run:
        """Return the simulation of one part."""
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
        """Slice of each extension in the vector."""
        edges = [len(self.theta)]
        for extension in self.extensions:
            edges.append(edges[-1] + len(extension.free().value))
        return tuple(slice(a, b) for a, b in itertools.pairwise(edges))

    @property
    def vector(self) -> Array:
        """The parameter vector: hysteresis, then extensions."""
        return np.concatenate([self.theta, *(e.free().value for e in self.extensions)])

    def bounds(self, longest_lag_s: float) -> tuple[Array, Array]:
        """Return lower and upper bounds of the vector.

        Thresholds may exceed the range of the drive, where a play does not move: a bound on the
        sum of all gaps would change the direction of every step.
        """
        lower, upper = self.coordinates.bounds(longest_lag_s)
        frees = [e.free() for e in self.extensions]
        lower = np.concatenate([lower, *(f.lower for f in frees)])
        upper = np.concatenate([upper, *(f.upper for f in frees)])
        for numbers in self.fixed:
            lower[numbers] = upper[numbers] = self.vector[numbers]
        return lower, upper

    def at(self, vector: Array) -> "State":
        """Return the point with this vector."""
        theta = vector[: len(self.theta)]
        extensions = tuple(
            extension.moved_to(vector[numbers])
            for extension, numbers in zip(self.extensions, self.slices, strict=True)
        )
        return replace(self, theta=theta, extensions=extensions)


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
        if not structure.memory:  # after a drive from the middle down, up and to its first sample
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
        fixed += [
            numbers
            for extension, numbers in zip(state.extensions, state.slices, strict=True)
            if any(extension is previous for previous in model.extensions)
        ]
        fixed.append(slice(0, coordinates.shared))
    if not structure.memory:
        fixed += [coordinates.memory_slice(k) for k in range(len(parts))]
    return replace(state, fixed=tuple(fixed))


def _scaled(model: AxisModel, scales: Scales, *, keep_lag: bool) -> Scaled:
    """Return the operator of a model in scaled units: the inverse of ``physical``."""
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
