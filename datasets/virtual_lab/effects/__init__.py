"""Effects of the simulated stages, by their place in the signal chain.

The docstring of the function that installs an effect explains its physics. Effects at the same
place of the chain are applied in the order of ``EFFECTS``.
"""

from piezoid_datasets.virtual_lab.effects import acquisition, ceramic, drive, mechanics, sensor
from piezoid_datasets.virtual_lab.effects.effect import Effect

EFFECTS: tuple[Effect, ...] = (
    drive.initial_state,
    drive.slew_limit,
    drive.amplifier_saturation,
    ceramic.rate_dependence,
    ceramic.non_congruence,
    ceramic.asymmetry,
    ceramic.creep,
    mechanics.resonance,
    mechanics.gain_change,
    mechanics.cross_coupling,
    mechanics.thermal_drift,
    sensor.sensor_periodic_error,
    sensor.lag,
    sensor.delay,
    sensor.mains_interference,
    acquisition.quantisation,
    acquisition.outliers,
    acquisition.timestamp_fault,
)
