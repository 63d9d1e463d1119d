"""A stage of three axes for the verification tests: gains placed by hand, nothing searched."""

import numpy as np

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.plant import Section
from piezoid.export.export_stage import observer_values
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.linear import first_order, resonance
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction
from tests.design.placed import place_observer
from tests.design.rig import lateral_chain
from tests.runtime.observer_design import poles
from tests.runtime.runtime_parameters import tunnelling

RATE_Hz = 20e3
GAIN_m_per_V = 3.5e-6
LSB_V = 20 / 65536
AMPLIFIER, MODE, SENSOR = (
    Section(frequency_Hz=4e3),
    Section(frequency_Hz=630.0, damping=0.05),
    Section(frequency_Hz=8.5e3),
)
DECAY_per_m = 10.246e9
NEPERS_PER_V = 18e-9 * DECAY_per_m

# 5 nm a retract, 0.35 nm of search, 5 retracts within a second of each other.
WATCH = {
    "retract_step_V": 0.278,
    "approach_step_V": 5e-4,
    "approach_log_step": 0.09,
    "contact_log": 0.73,
    "search_voltage_V": 0.0194,
    "trip_limit": 5,
    "trip_samples": 20000,
    "bad_samples": 20,
    "contact_samples": 20,
    "retract_samples": 200,
    "stuck_samples": 20,
    "stuck_voltage_V": 0.004,
    "stuck_current_A": -1.0,
}


def swing(samples=2000, amplitude_m=2e-5, frequency_Hz=20.0):
    """Return a sine whose amplitude grows linearly from zero."""
    k = np.arange(samples)
    return amplitude_m * np.sin(2 * np.pi * frequency_Hz * k / RATE_Hz) * k / samples


def operator(weight_factor=1.0, offset_V=0.0):
    weight = GAIN_m_per_V * np.array([0.72, 0.12, 0.08, 0.06, 0.04])
    weight[1:] *= weight_factor
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(threshold=np.array([0.0, 0.5, 1.0, 2.0, 3.5]), weight=weight),
        dead_zones=DeadZones(
            threshold=np.array([-1e-5, 0.0, 8e-6]), weight=np.array([-0.03, 1.0, 0.04])
        ),
        voltage_offset_V=offset_V,
    )


def lateral(axis="x", *, weight_factor=1.05, noise_rms=1e-9, **overrides):
    """Return the plant of a lateral axis; its play weights differ by 5 % from the controller's."""
    values = {
        "response": Hysteresis(operator=operator(weight_factor)),
        "front": (first_order(AMPLIFIER.frequency_Hz),),
        "measured": resonance(MODE.frequency_Hz, MODE.damping),
        "sensor": (first_order(SENSOR.frequency_Hz),),
        **overrides,
    }
    return AxisPlant(
        axis=axis, label="identified", sampling_rate_Hz=RATE_Hz, noise_rms=noise_rms, **values
    )


def junction(gain=NEPERS_PER_V):
    return AxisPlant(
        axis="z",
        label="identified",
        sampling_rate_Hz=RATE_Hz,
        response=Junction(current_A=1e-9, gain_nepers_per_V=gain, decay_per_m=DECAY_per_m),
        delay_s=1 / RATE_Hz,
        front=(first_order(AMPLIFIER.frequency_Hz),),
        sensor=(first_order(10e3),),
        noise_rms=2e-12,
        noise_bandwidth_Hz=10e3,
        reading_range=(-1e-8, 1e-8),
    )


def lateral_parameters(axis="x"):
    observer = place_observer(
        plant_from_chain(lateral_chain(GAIN_m_per_V)),
        feedback_poles=np.r_[poles(630, 0.9), poles([4e3, 8.5e3])],
        observer_poles=np.r_[poles(1200, 0.8), poles([800, 4200, 8600])],
    )
    model = operator()
    common = {
        **observer_values(observer),
        "voltage_minimum_V": -10.0,
        "voltage_maximum_V": 10.0,
        "lsb_V": LSB_V,
        "reference_minimum_m": -3e-5,
        "reference_maximum_m": 3e-5,
        "displacement_minimum_m": -4.5e-5,
        "displacement_maximum_m": 4.5e-5,
        "stuck_samples": 20,
        "stuck_voltage_V": 0.1,
        "blind_samples": 2000,
        "play_count": 5,
        "play_threshold_V": model.plays.threshold,
        "play_weight_m_per_V": model.plays.weight,
        "knot_count": 3,
        "knot_m": model.dead_zones.threshold,
        "knot_weight": model.dead_zones.weight,
    }
    values, *alternatives = [{**common, "method": m} for m in ("mpi_dob", "dob", "mpi", "none")]
    return AxisParameters(axis=axis, values=values, alternatives=tuple(alternatives))


def stage(*axes):
    makers = {
        "x": lateral_parameters,
        "y": lambda: lateral_parameters("y"),
        "z": lambda: AxisParameters(
            axis="z",
            values=tunnelling(
                lsb_V=LSB_V / 32, current_ceiling_A=9e-9, retract_voltage_V=-10.0, **WATCH
            ),
        ),
    }
    names = axes or ("x", "y", "z")
    return ParameterFile(name="stage 42", axes=tuple(makers[name]() for name in names))


PLANTS = (lateral("x"), lateral("y"), junction())
