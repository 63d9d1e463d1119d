"""verify_stage: what ships against the model it was made from."""

from collections.abc import Sequence

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification.model import ActuatorModel
from piezoid.verification.criteria import Limits
from piezoid.verification.plant import AxisPlant, lateral_plant
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
    """Verify the lateral axes of a parameter file against the identified stage.

    draws  how many other stages the recordings allow are run as well

    Raises ``ParameterFileError`` for a tunnelling axis: its plant comes from a closed-loop
    identification, see ``junction_axis_plant``.
    """
    rng = np.random.default_rng([seed, draws])
    plants: list[AxisPlant] = []
    drawn: list[tuple[AxisPlant, ...]] = []
    for axis in file.axes:
        if axis.method == "rst":
            raise ParameterFileError(
                f"axis {axis.axis} regulates a current, and model.json holds no plant of it",
                needed="the plant that a closed-loop identification found",
                remedy="Call piezoid.verification.verify with junction_axis_plant.",
            )
        rate_Hz = float(axis.values["sampling_rate_Hz"])
        plants.append(lateral_plant(model[axis.axis], sampling_rate_Hz=rate_Hz))
        drawn.append(varied_plants(plants[-1], model[axis.axis], count=draws, rng=rng))
    variations = list(zip(*drawn, strict=False))  # as many sets as the axis with the fewest
    return verify(file, plants, variations=variations, limits=limits, proofs=proofs, seed=seed)
