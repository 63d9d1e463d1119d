"""Other plants that the recordings allow as well as the identified one."""

from dataclasses import replace

import numpy as np

from piezoid.design.chain import Section
from piezoid.design.replicates import draw_replicates
from piezoid.identification.model import AxisModel
from piezoid.operators.linear import ContinuousSystem
from piezoid.verification.plant import AxisPlant, Hysteresis

_POLE_SPREAD = 0.1  # a data sheet's bandwidth is a round number for a typical specimen
_TRIED = 20  # draws for each plant wanted: those without an inverse are not kept


def varied_plants(
    plant: AxisPlant, model: AxisModel, *, count: int, rng: np.random.Generator
) -> tuple[AxisPlant, ...]:
    """Draw the operator from the fit's covariance, and move every pole by up to 10 %.

    plant  the identified one
    count  how many at most: fewer where too few draws have an inverse
    """
    drawn = draw_replicates(model, rng, draws=_TRIED * count)[:count]
    found = []
    for place, operator in enumerate(drawn, start=1):
        factor = 1.0 + _POLE_SPREAD * float(rng.uniform(-1.0, 1.0))
        found.append(
            replace(
                plant,
                label=f"draw {place}",
                response=Hysteresis(operator=operator, polarity=model.polarity),
                amplifier=_moved(plant.amplifier, factor),
                mechanics=_moved(plant.mechanics, factor),
                sensor=_moved(plant.sensor, factor),
                measured=_quickened(plant.measured, factor),
            )
        )
    return tuple(found)


def _moved(sections: tuple[Section, ...], factor: float) -> tuple[Section, ...]:
    return tuple(replace(s, frequency_Hz=s.frequency_Hz * factor) for s in sections)


def _quickened(system: ContinuousSystem | None, factor: float) -> ContinuousSystem | None:
    """Return a system all of whose poles are faster by a factor, its gain at rest unchanged."""
    if system is None:
        return None
    return replace(system, A=system.A * factor, B=system.B * factor)
