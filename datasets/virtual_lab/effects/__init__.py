"""Effects of the simulated stages: one file each, with the physics in its docstring.

Effects at the same place of the signal chain are applied in the order of ``EFFECTS``.
"""

from piezoid_datasets.virtual_lab.effects import (
    amplifier_saturation,
    asymmetry,
    creep,
    cross_coupling,
    delay,
    gain_change,
    initial_state,
    lag,
    mains_interference,
    non_congruence,
    outliers,
    quantisation,
    rate_dependence,
    resonance,
    sensor_periodic_error,
    slew_limit,
    thermal_drift,
    timestamp_fault,
)
from piezoid_datasets.virtual_lab.effects.effect import Effect

EFFECTS: tuple[Effect, ...] = (
    initial_state.EFFECT,
    slew_limit.EFFECT,
    amplifier_saturation.EFFECT,
    rate_dependence.EFFECT,
    non_congruence.EFFECT,
    asymmetry.EFFECT,
    creep.EFFECT,
    resonance.EFFECT,
    gain_change.EFFECT,
    cross_coupling.EFFECT,
    thermal_drift.EFFECT,
    sensor_periodic_error.EFFECT,
    lag.EFFECT,
    delay.EFFECT,
    mains_interference.EFFECT,
    quantisation.EFFECT,
    outliers.EFFECT,
    timestamp_fault.EFFECT,
)
