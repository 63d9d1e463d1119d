"""Other plants that the recordings allow as well as the identified one."""

from dataclasses import replace

import numpy as np

from piezoid.design.replicates import draw_replicates
from piezoid.identification.loop_model import at_corner
from piezoid.identification.model import AxisModel
from piezoid.verification.plant import AxisPlant, Hysteresis, lateral_plant

_TRIED = 20  # draws for each plant wanted: those without an inverse are not kept


def varied_plants(
    plant: AxisPlant, model: AxisModel, *, count: int, rng: np.random.Generator
) -> tuple[AxisPlant, ...]:
    """Draw operators from the fit's covariance, with poles and modes between their ends.

    plant  the identified one
    count  how many at most: fewer where too few draws have an inverse
    """
    drawn = draw_replicates(model, rng, draws=_TRIED * count)[:count]
    found = []
    for place, operator in enumerate(drawn, start=1):
        slower, sharper = rng.uniform(-1.0, 1.0, 2).tolist()
        moved = lateral_plant(
            at_corner(model, slower, sharper), sampling_rate_Hz=plant.sampling_rate_Hz
        )
        assert isinstance(moved.response, Hysteresis)
        found.append(
            replace(
                moved,
                label=f"draw {place}",
                response=replace(moved.response, operator=operator),
                reading_step=plant.reading_step,
                reading_range=plant.reading_range,
            )
        )
    return tuple(found)
