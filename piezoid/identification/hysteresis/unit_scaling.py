"""Conversion from scaled units to volts and metres."""

import numpy as np

from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.coordinates import Coordinates, Scaled, operator_of
from piezoid.identification.hysteresis.pieces import Piece, Scales
from piezoid.identification.piece_start import PieceStart
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii


def to_si_units(
    operator: Scaled, scales: Scales, offset_m: float = 0.0
) -> ModifiedPrandtlIshlinskii:
    """Return the operator in SI units, rising with the drive for either polarity of the sensor.

    The envelope is normalised to the range of the drive: gamma(R) - gamma(-R) = 2 R.
    """
    stroke_m = abs(scales.displacement_m)
    stretch = envelope_stretch(operator)
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], operator.threshold]) * (stretch * scales.voltage_V),
            weight=operator.weight * (stroke_m / (stretch * scales.voltage_V)),
        ),
        dead_zones=from_slopes(operator.knot * stroke_m, operator.slope),
        voltage_offset_V=scales.voltage_offset_V,
        displacement_offset_m=offset_m,
        envelope=from_slopes(
            operator.envelope.threshold * scales.voltage_V, operator.envelope.slope * stretch
        ),
    )


def piece_start(
    piece: Piece, index: int, theta: Array, coordinates: Coordinates, scales: Scales, first: float
) -> PieceStart:
    """Return the initial state of a piece: its memory before the first sample, and its zero.

    index  of the piece in the parameter vector
    first  scaled drive behind the amplifier at the first sample
    """
    operator = operator_of(theta, coordinates)
    memory = Forward(operator=operator).memory(first, theta[coordinates.memory_slice(index)])
    zero = theta[coordinates.offset_slice(index)]
    return PieceStart(
        recording=piece.name,
        memory_V=memory * (envelope_stretch(operator) * scales.voltage_V),
        zero_m=piece.centre_m + scales.displacement_m * zero,
        first=piece.first,
        last=piece.last,
    )


def envelope_stretch(operator: Scaled) -> float:
    """Return the factor that normalises the envelope to the range of the drive."""
    low, high = operator.envelope.run(np.array([-1.0, 1.0]))
    return float(2.0 / (high - low))


def parameter_names(operator: Scaled) -> tuple[str, ...]:
    """Return the names of ``parameter_values``, in their order."""
    plays, zones = len(operator.gap), len(operator.knot)
    return (
        *(f"play_threshold_V[{i}]" for i in range(1, plays + 1)),
        *(f"play_weight_m_per_V[{i}]" for i in range(plays + 1)),
        *(f"dead_zone_threshold_m[{j}]" for j in range(zones)),
        *(f"dead_zone_weight[{j}]" for j in range(zones)),
        *(f"envelope_weight[{j}]" for j in range(len(operator.envelope.weight))),
        "lag_s",
    )


def parameter_values(theta: Array, coordinates: Coordinates, scales: Scales) -> Array:
    """Return the shared parameters of a vector in SI units, (parameters,)."""
    operator = operator_of(theta, coordinates)
    model = to_si_units(operator, scales)
    return np.concatenate(
        [
            model.plays.threshold[1:],
            model.plays.weight,
            model.dead_zones.threshold,
            model.dead_zones.weight,
            model.envelope.weight,
            [operator.lag_s],
        ]
    )
