"""Effects of the simulated stages, by their place in the signal chain.

The docstring of the function that installs an effect explains its physics. Effects at the same
place of the chain are applied in the order of ``EFFECTS``.
"""

from piezoid_datasets.virtual_lab.effects.acquisition import (
    OUTLIERS,
    QUANTISATION,
    TIMESTAMP_FAULT,
)
from piezoid_datasets.virtual_lab.effects.ceramic import (
    ASYMMETRY,
    CREEP,
    NON_CONGRUENCE,
    RATE_DEPENDENCE,
)
from piezoid_datasets.virtual_lab.effects.drive import (
    AMPLIFIER_SATURATION,
    INITIAL_STATE,
    SLEW_LIMIT,
)
from piezoid_datasets.virtual_lab.effects.effect import Effect
from piezoid_datasets.virtual_lab.effects.mechanics import (
    CROSS_COUPLING,
    GAIN_CHANGE,
    RESONANCE,
    THERMAL_DRIFT,
)
from piezoid_datasets.virtual_lab.effects.sensor import (
    DELAY,
    LAG,
    MAINS_INTERFERENCE,
    SENSOR_PERIODIC_ERROR,
)

EFFECTS: tuple[Effect, ...] = (
    INITIAL_STATE,
    SLEW_LIMIT,
    AMPLIFIER_SATURATION,
    RATE_DEPENDENCE,
    NON_CONGRUENCE,
    ASYMMETRY,
    CREEP,
    RESONANCE,
    GAIN_CHANGE,
    CROSS_COUPLING,
    THERMAL_DRIFT,
    SENSOR_PERIODIC_ERROR,
    LAG,
    DELAY,
    MAINS_INTERFERENCE,
    QUANTISATION,
    OUTLIERS,
    TIMESTAMP_FAULT,
)
