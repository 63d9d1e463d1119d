"""verify_stage: what ships against the model it was made from."""

from collections.abc import Sequence

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.model import ActuatorModel
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.operators.tunnelling import ELEMENTARY_CHARGE_C, decay_of_barrier
from piezoid.verification.criteria import Limits
from piezoid.verification.plant import (
    AxisPlant,
    junction_axis_plant,
    lateral_plant,
    with_gain,
)
from piezoid.verification.proof import Proof
from piezoid.verification.uncertainty import varied_plants
from piezoid.verification.verification import Verification
from piezoid.verification.verify import verify

DRAWS = 6


def verify_stage(
    file: ParameterFile,
    model: ActuatorModel,
    *,
    limits: Limits | None = None,
    proofs: Sequence[Proof] = (),
    draws: int = DRAWS,
    seed: int = 0,
) -> Verification:
    """Verify a parameter file against the identified stage.

    draws  how many other stages the recordings allow are run as well

    Raises ``ParameterFileError`` for a tunnelling axis where the model has no plant of it.
    """
    rng = np.random.default_rng([seed, draws])
    plants: list[AxisPlant] = []
    drawn: list[tuple[AxisPlant, ...]] = []
    for axis in file.axes:
        if axis.method == "rst":
            plants.append(_tip(axis, model.tunnelling))
            drawn.append(_family(plants[-1], model.tunnelling, draws))
            continue
        rate_Hz = float(axis.values["sampling_rate_Hz"])
        plants.append(lateral_plant(model[axis.axis], sampling_rate_Hz=rate_Hz))
        drawn.append(varied_plants(plants[-1], model[axis.axis], count=draws, rng=rng))
    variations = list(zip(*drawn, strict=False))  # as many sets as the axis with the fewest
    return verify(file, plants, variations=variations, limits=limits, proofs=proofs, seed=seed)


def _tip(axis: AxisParameters, tunnelling: TunnellingModel | None) -> AxisPlant:
    """Return the plant of a tunnelling axis at its set point, with the least noise there can be.

    i_n = sqrt(2 e i B), the shot noise through a first-order sensor, B = pi f / 2 [Schottky 1918]
    """
    if tunnelling is None or tunnelling.loop_plant is None:
        raise ParameterFileError(
            f"axis {axis.axis} regulates a current, and model.json holds no plant of it",
            needed="the plant that a closed-loop identification found",
            remedy="Call piezoid.verification.verify.verify with junction_axis_plant.",
        )
    loop = tunnelling.loop_plant
    set_point_A = float(axis.values["current_reference_A"])
    band_Hz = 0.5 * np.pi * loop.plant.sensor_pole_Hz
    return junction_axis_plant(
        loop.plant,
        axis=axis.axis,
        set_point_A=set_point_A,
        decay_per_m=decay_of_barrier(loop.barrier_eV),
        noise_rms_A=float(np.sqrt(2.0 * ELEMENTARY_CHARGE_C * set_point_A * band_Hz)),
    )


def _family(
    plant: AxisPlant, tunnelling: TunnellingModel | None, count: int
) -> tuple[AxisPlant, ...]:
    """Return the plants a controller has to hold, those of the extreme gains first."""
    assert tunnelling is not None
    assert tunnelling.loop_plant is not None
    nominal = tunnelling.loop_plant.plant.gain_nepers_per_V
    ratios = [m.gain_nepers_per_V / nominal for m in tunnelling.loop_plant.family]
    extreme = sorted(ratios, key=lambda ratio: -abs(np.log(ratio)))
    repeated = [extreme[k % len(extreme)] for k in range(count)]
    return tuple(with_gain(plant, ratio, f"gain x{ratio:.3g}") for ratio in repeated)
