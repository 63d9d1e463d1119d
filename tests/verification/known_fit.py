"""A model known by heart with an amplifier, a sensor, and a tip: nothing is fitted for a test."""

from dataclasses import replace

from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import ActuatorModel, Lag
from piezoid.identification.tunnelling.confidence import Confidence
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.identification.tunnelling.loop_model import LoopPlant
from piezoid.identification.tunnelling.model import TunnellingModel
from tests.reports.known_stage import axis_model
from tests.verification.rig import NEPERS_PER_V, lateral_parameters

RATE_Hz = 20e3
SOURCES = {"sweep.csv": "sha256:" + "0" * 64}


def fitted():
    axis = replace(
        axis_model(),
        lag=Lag(kind="first_order", time_s=2.5e-4),
        rig=Rig(amplifier_bandwidth_Hz=4e3, sensor_bandwidth_Hz=8.5e3),
    )
    return ActuatorModel(stage="known", axes={"x": axis}, sources=SOURCES)


def junction_model(ratios=(1.0, 0.8, 1.25)):
    nominal = JunctionPlant(
        gain_nepers_per_V=NEPERS_PER_V,
        sensor_pole_Hz=10e3,
        delay_s=5e-5,
        amplifier_pole_Hz=4e3,
        sampling_rate_Hz=RATE_Hz,
    )
    loop = LoopPlant(
        plant=nominal,
        gain_interval=(0.9 * NEPERS_PER_V, 1.1 * NEPERS_PER_V),
        sensor_pole_interval_Hz=(9e3, 11e3),
        delay_interval_s=(4e-5, 6e-5),
        barrier_eV=1.0,
        barrier_interval_eV=(0.9, 1.1),
        naive_gain=1.0,
        naive_reason="",
        family=tuple(replace(nominal, gain_nepers_per_V=NEPERS_PER_V * r) for r in ratios),
        family_records=1,
        confidence=Confidence.HIGH,
        reasons=(),
    )
    return replace(fitted(), tunnelling=TunnellingModel(gap_law=None, loop_plant=loop))


def shipped(method):
    """Hand-placed parameters with the known stage's centre."""
    offsets = {"voltage_offset_V": 5.0, "displacement_offset_m": 2e-6}
    return lateral_parameters().for_method(method).with_values(offsets)
