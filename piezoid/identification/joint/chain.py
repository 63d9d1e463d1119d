"""From a drive to a reading with everything in it, in scaled units, sample by sample.

u -> drive extensions -> plays -> irreversible extensions -> Psi -> response extensions
  -> own lag -> declared sensor pole -> + zero + what is added -> reading
"""

from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.filters import lagged, relaxed
from piezoid.identification.joint.vector import Part, State
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii


@dataclass(frozen=True, kw_only=True, eq=False)
class Followed:
    """One part from end to end.

    drive    (samples,)  what reaches the ceramic
    static   (samples,)  what the hysteresis makes of it
    reading  (samples,)  what the sensor says
    """

    drive: Array
    static: Array
    reading: Array


def follow(state: State, index: int, part: Part) -> Followed:
    """Simulate one part from its first sample."""
    drive = _driven(state, part)
    static = _static(state, index, part, drive)
    return Followed(drive=drive, static=static, reading=_read(state, index, part, static))


def residual(state: State, index: int, part: Part) -> Array:
    """Return model minus measurement at the rows that count."""
    return np.asarray(follow(state, index, part).reading - part.piece.response)[part.place]


def _driven(state: State, part: Part) -> Array:
    scales, drive = state.scales, part.piece.drive
    voltage_V = scales.voltage_offset_V + scales.voltage_V * drive
    reached_V = voltage_V
    for extension in state.extensions:
        reached_V = extension.drive(reached_V, part.where.rate_Hz)
    if reached_V is voltage_V:
        return drive
    return np.ascontiguousarray((reached_V - scales.voltage_offset_V) / scales.voltage_V)


def first_memory(state: State, index: int, drive: Array) -> Array:
    """Return the memory of the moving plays before a part's first sample."""
    operator = state.operator
    slopes = state.theta[state.coordinates.memory_slice(index)]
    return np.asarray(operator.envelope.run(drive[:1]) + np.cumsum(operator.gap * slopes))


def _static(state: State, index: int, part: Part, drive: Array) -> Array:
    operator = state.operator
    inner = operator.envelope.run(drive)
    memory = np.concatenate([inner[:1], first_memory(state, index, drive)])
    plays = PrandtlIshlinskii(
        threshold=np.concatenate([[0.0], operator.threshold]), weight=operator.weight
    )
    h, _ = plays.run(inner, memory)
    reversible, stroke_m = operator.weight[0] * inner, abs(state.scales.displacement_m)
    for extension in state.extensions:
        walls_m = (h - reversible) * stroke_m
        slow_m = extension.irreversible(walls_m, part.where.rate_Hz)
        h = h if slow_m is walls_m else reversible + slow_m / stroke_m
    return from_slopes(operator.knot, operator.slope).run(h)


def passed(state: State, part: Part, moved: Array, *, instant: bool = False) -> Array:
    """Return columns behind all filters, or behind those alone that follow within samples."""
    for extension in state.extensions:
        if extension.instant or not instant:
            moved = extension.response(moved, part.where)
    rate_Hz = part.where.rate_Hz
    moved = lagged(moved, state.coordinates.shape.lag, state.operator.lag_s, rate_Hz)
    pole_Hz = state.rig.sensor_bandwidth_Hz
    return moved if pole_Hz is None else relaxed(moved, 1.0 / (2.0 * np.pi * pole_Hz), rate_Hz)


def late_s(state: State, rate_Hz: float) -> float:
    """Return by how much the filters make slow motion late."""
    pole_Hz = state.rig.sensor_bandwidth_Hz
    declared_s = 0.0 if pole_Hz is None else 1.0 / (2.0 * np.pi * pole_Hz)
    return (
        declared_s
        + state.operator.lag_s
        + sum(extension.late_s(rate_Hz) for extension in state.extensions)
    )


def _read(state: State, index: int, part: Part, static: Array) -> Array:
    scale_m, centre_m = state.scales.displacement_m, part.piece.centre_m
    zero = float(state.theta[state.coordinates.offset_slice(index)][0])
    moved_m = passed(state, part, static * scale_m)
    position_m = centre_m + scale_m * zero + moved_m
    for extension in state.extensions:
        position_m = position_m + extension.added(part.where)
    for extension in state.extensions:
        position_m = extension.reading(position_m)
    return np.asarray((position_m - centre_m) / scale_m)
