"""Operators the data allow: draws from the covariance of a fit, those that are operators."""

import numpy as np

from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

_DRAWS = 200


def draw_replicates(
    axis: AxisModel, rng: np.random.Generator, *, draws: int = _DRAWS
) -> tuple[ModifiedPrandtlIshlinskii, ...]:
    """Draw parameters from the fit's normal law; keep the draws that have an inverse.

    draws  tried; the truth is taken to have an inverse, so that the others are not possible

    Numbers on a bound have no variance and stay there.
    """
    found = axis.uncertainty
    values, vectors = np.linalg.eigh(found.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    thetas = found.values + rng.standard_normal((draws, len(values))) @ root.T
    made = [_operator(axis, dict(zip(found.names, theta, strict=True))) for theta in thetas]
    return tuple(operator for operator in made if operator is not None and operator.is_invertible)


def _operator(axis: AxisModel, drawn: dict[str, float]) -> ModifiedPrandtlIshlinskii | None:
    """Return the operator of these numbers, or None where thresholds cross."""
    model = axis.hysteresis
    plays, zones, envelope = model.plays, model.dead_zones, model.envelope
    play_V = _drawn("play_threshold_V", plays.threshold, drawn)
    zone_m = _drawn("dead_zone_threshold_m", zones.threshold, drawn)
    play_V[0], zone_m[zones.zero] = 0.0, 0.0
    if not ((np.diff(play_V) > 0).all() and (np.diff(zone_m) > 0).all()):
        return None
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=play_V, weight=_drawn("play_weight_m_per_V", plays.weight, drawn)
        ),
        dead_zones=DeadZones(
            threshold=zone_m, weight=_drawn("dead_zone_weight", zones.weight, drawn)
        ),
        voltage_offset_V=model.voltage_offset_V,
        displacement_offset_m=model.displacement_offset_m,
        envelope=DeadZones(
            threshold=envelope.threshold,
            weight=_drawn("envelope_weight", envelope.weight, drawn),
        ),
    )


def _drawn(stem: str, fitted: Array, drawn: dict[str, float]) -> Array:
    """Return the drawn numbers of one array; what was not fitted stays as it is."""
    return np.array([drawn.get(f"{stem}[{i}]", value) for i, value in enumerate(fitted.tolist())])
