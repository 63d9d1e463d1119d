"""From refits to intervals: parameters, loading curve, loop width, limits of weights on zero."""

import numpy as np

from piezoid.identification.hysteresis.coordinates import Coordinates, operator_of
from piezoid.identification.hysteresis.jackknife import Jackknife
from piezoid.identification.hysteresis.physical import (
    envelope_stretch,
    parameter_names,
    parameter_values,
    physical,
)
from piezoid.identification.hysteresis.pieces import Scales
from piezoid.identification.quality import Uncertainty
from piezoid.numerics.arrays import Array

POINTS = 41


def summarise(found: Jackknife, coordinates: Coordinates, scales: Scales) -> Uncertainty:
    """Return intervals of everything the report and the design ask for."""
    reach_V = np.linspace(0.0, scales.voltage_V, POINTS)

    def parameters(theta: Array) -> Array:
        return parameter_values(theta, coordinates, scales)

    def loading(theta: Array) -> Array:
        model = physical(operator_of(theta, coordinates), scales)
        return model.run(model.voltage_offset_V + reach_V, model.virgin_memory())[0]

    def width(theta: Array) -> Array:
        return np.array([loop_width_m(theta, coordinates, scales)])

    return Uncertainty(
        blocks=found.blocks,
        names=parameter_names(operator_of(found.theta, coordinates)),
        values=parameters(found.theta),
        covariance=found.spread(parameters),
        upper_limit=_upper_limits(found, coordinates, scales),
        reach_V=reach_V,
        loading_m=loading(found.theta),
        loading_half_m=found.half_width(loading),
        loop_width_m=(float(width(found.theta)[0]), float(found.half_width(width)[0])),
    )


def loop_width_m(theta: Array, coordinates: Coordinates, scales: Scales) -> float:
    """Return how far the full steady loop is open where the drive passes its middle.

    2 sum_i w_i min(r_i, A - r_i)_+ seen through Psi, A half the range of the drive
    """
    model = physical(operator_of(theta, coordinates), scales)
    plays = model.plays
    half = float(
        (plays.weight * np.clip(scales.voltage_V - plays.threshold, 0.0, plays.threshold)).sum()
    )
    low_m, high_m = model.dead_zones.run(np.array([-half, half]))
    return float(high_m - low_m)


def _upper_limits(found: Jackknife, coordinates: Coordinates, scales: Scales) -> dict[str, float]:
    """Return one-sided limits of the play weights that lie on zero, m/V."""
    stretch = envelope_stretch(operator_of(found.theta, coordinates))
    unit = abs(scales.displacement_m) / (stretch * scales.voltage_V)
    first = coordinates.slices["weight"].start
    return {
        f"play_weight_m_per_V[{i}]": found.upper_limit(first + i) * unit
        for i in range(1, coordinates.shape.plays + 1)
        if found.theta[first + i] <= 0.0
    }
