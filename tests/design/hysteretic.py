"""A hysteresis of five plays, and the loop that is designed for its gain."""

from collections.abc import Iterator

import numpy as np

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.observer import DisturbanceObserver
from piezoid.design.plant import Plant
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from tests.design.placed import place_observer
from tests.design.rig import LATERAL_m_per_V, lateral_chain, printed_observer_poles

THRESHOLD_V = np.array([0.0, 0.5, 1.0, 2.0, 3.5])
SLOPES = np.array([0.72, 0.84, 0.92, 0.98, 1.02])
REACH_V = 3.0
ROUNDING_FACTOR = 1.0 + 1e-9  # the bounds are met exactly by some inputs


def hysteresis(
    scale: float = 1.0, zones: DeadZones = LINEAR, envelope: DeadZones = LINEAR
) -> ModifiedPrandtlIshlinskii:
    weight = np.diff(SLOPES, prepend=0.0) * LATERAL_m_per_V
    weight[1:] *= scale
    plays = PrandtlIshlinskii(threshold=THRESHOLD_V, weight=weight)
    return ModifiedPrandtlIshlinskii(plays=plays, dead_zones=zones, envelope=envelope)


def curved() -> DeadZones:
    return DeadZones(threshold=np.array([-4e-6, 0.0, 5e-6]), weight=np.array([0.05, 1.0, -0.06]))


def random_drives(
    rng: np.random.Generator, count: int, *, samples: int = 400, min_share: float = 0.2
) -> Iterator[Array]:
    """Draw random walks whose extremes lie between ``min_share`` of the reach and the reach."""
    for _ in range(count):
        u = np.cumsum(rng.normal(size=samples))
        yield u * REACH_V / np.abs(u).max() * rng.uniform(min_share, 1.0)


def loop(bounds: HysteresisBounds) -> tuple[Plant, DisturbanceObserver]:
    plant = plant_from_chain(lateral_chain(bounds.gain_m_per_V))
    feedback, observer = printed_observer_poles()
    return plant, place_observer(plant, feedback_poles=feedback, observer_poles=observer)
