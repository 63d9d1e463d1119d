"""An identified tunnelling loop, and the lab.toml of its stage."""

from dataclasses import replace

from piezoid.identification.quality import Confidence
from piezoid.identification.tunnelling.closed_loop import LoopPlant
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.records.lab import Acquisition, Lab, Tunnelling
from tests.design.rig import NEPER_PER_V, RATE_Hz

LAB = Lab(
    acquisition=Acquisition(
        sampling_rate_Hz=RATE_Hz, dac_bits=16, adc_bits=16, input_range_V=(-10.0, 10.0)
    ),
    tunnelling=Tunnelling(
        set_point_A=1e-9,
        floor_A=1e-11,
        ceiling_A=9e-9,
        feedback_ohm=1e9,
        barrier_range_eV=(0.25, 4.0),
    ),
)


NOMINAL = JunctionPlant(
    gain_nepers_per_V=NEPER_PER_V,
    sensor_pole_Hz=10e3,
    delay_s=1.0 / RATE_Hz,
    amplifier_pole_Hz=4e3,
    sampling_rate_Hz=RATE_Hz,
)
SLOW = replace(NOMINAL, sensor_pole_Hz=8e3, delay_s=1.3 / RATE_Hz)


def loop_plant(
    *,
    ratios: tuple[float, ...] = (1.0, 0.8, 1.25),
    further_members: tuple[JunctionPlant, ...] = (SLOW,),
) -> LoopPlant:
    """Amplifier 4 kHz, sensor 10 kHz, one sample of delay; members differ in gain."""
    gains = tuple(replace(NOMINAL, gain_nepers_per_V=NEPER_PER_V * ratio) for ratio in ratios)
    return LoopPlant(
        plant=NOMINAL,
        gain_interval=(0.9 * NEPER_PER_V, 1.1 * NEPER_PER_V),
        sensor_pole_interval_Hz=(9e3, 11e3),
        delay_interval_s=(4e-5, 6e-5),
        barrier_eV=1.0,
        barrier_interval_eV=(0.9, 1.1),
        naive_gain=1.0,
        naive_reason="",
        family=(*gains, *further_members),
        family_records=1,
        confidence=Confidence.HIGH,
        reasons=(),
    )
