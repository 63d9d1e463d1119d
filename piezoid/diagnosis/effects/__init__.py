"""All effects, data faults first, then effects on the drive, then on the displacement.

Start at the class ``Effect``, which describes every field.
To add an effect, add a file here and its line in ``EFFECTS`` below: detection, size, control
advice and next experiment are in that file alone.
"""

from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.effects import (
    amplifier_saturation,
    asymmetry,
    creep,
    cross_coupling,
    delay,
    gain_change,
    initial_state,
    lag,
    loop_shape,
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

EFFECTS: tuple[Effect, ...] = (
    timestamp_fault.EFFECT,
    outliers.EFFECT,
    quantisation.EFFECT,
    amplifier_saturation.EFFECT,
    slew_limit.EFFECT,
    delay.EFFECT,
    lag.EFFECT,
    resonance.EFFECT,
    rate_dependence.EFFECT,
    creep.EFFECT,
    thermal_drift.EFFECT,
    cross_coupling.EFFECT,
    mains_interference.EFFECT,
    sensor_periodic_error.EFFECT,
    gain_change.EFFECT,
    initial_state.EFFECT,
    asymmetry.EFFECT,
    non_congruence.EFFECT,
    loop_shape.EFFECT,
)


def every_effect() -> tuple[Effect, ...]:
    """Return the present catalogue of effects."""
    return EFFECTS


def effect_named(name: str) -> Effect:
    """Return the effect with a name; raises ``KeyError`` for an unknown name."""
    return {effect.name: effect for effect in EFFECTS}[name]
