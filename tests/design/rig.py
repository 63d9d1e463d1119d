"""Plants of the design tests: the two axes of a published rig, and random chains."""

from dataclasses import replace

import numpy as np

from benchmarks.varied_chains import Chain, family_from_chains, plant_from_chain, varied
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.plant import Plant, PlantFamily, Section
from piezoid.design.rst import closed_loop_target, place_poles, section_poles
from piezoid.design.specification import Specification, default_specification
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import from_roots, roots_of

RATE_Hz = 20e3
LATERAL_m_per_V = 15 * 235e-9
NEPER_PER_V = 18.0 * 10.246  # 1 eV
SECTOR = HysteresisBounds(
    form="affine",
    gain_m_per_V=LATERAL_m_per_V,
    slope_min=0.85,
    slope_max=1.15,
    error_m=1e-7,
    reach_V=3.0,
    conditions=("bounds for tests",),
)
LOOPS = ((300.0, 0.9), (1e3, 0.9), (2e3, 0.7), (3e3, 0.6))  # Hz and damping of targets


def lateral_chain(gain: float = 1.0, delay_s: float = 0.0) -> Chain:
    """Amplifier 4 kHz, mode 630 Hz with damping 0.05, sensor 8.5 kHz."""
    return Chain(
        label="lateral",
        sampling_rate_Hz=RATE_Hz,
        gain=gain,
        output_unit="m",
        sections=(
            Section(frequency_Hz=4e3),
            Section(frequency_Hz=630.0, damping=0.05),
            Section(frequency_Hz=8.5e3),
        ),
        delay_s=delay_s,
    )


def lateral_family() -> PlantFamily:
    """Return a nominal plant with a Butterworth filter that is not modelled, and corners."""
    chain = lateral_chain(LATERAL_m_per_V)
    truth = replace(
        chain,
        label="nominal",
        sections=(*chain.sections, Section(frequency_Hz=20e3, damping=0.5**0.5)),
    )
    corners = [
        varied(truth, gain_factor=g, mode_factor=f) for g in (0.85, 1.15) for f in (0.9, 1.1)
    ]
    return family_from_chains(truth, corners)


def lateral_model() -> Plant:
    """Return the model of the observer."""
    return plant_from_chain(lateral_chain(LATERAL_m_per_V))


def vertical_chain(barrier_eV: float = 1.0) -> Chain:
    """Amplifier 4 kHz, piezo 120 kHz, current sensor 10 kHz, one sample of delay."""
    return Chain(
        label=f"{barrier_eV:g} eV",
        sampling_rate_Hz=RATE_Hz,
        gain=NEPER_PER_V * barrier_eV**0.5,
        output_unit="1",
        sections=(
            Section(frequency_Hz=4e3),
            Section(frequency_Hz=120e3),
            Section(frequency_Hz=10e3),
        ),
        delay_s=1.0 / RATE_Hz,
    )


def vertical_family() -> PlantFamily:
    """Barriers 16:1, loop gains 4:1."""
    corners = [vertical_chain(barrier) for barrier in (0.25, 0.5, 2.0, 4.0)]
    return family_from_chains(vertical_chain(), corners)


def lateral_specification(bandwidth_Hz: float = 90.0) -> Specification:
    """Return limits for 1 nm of sensor noise and 0.35 um of hysteresis at 10 Hz."""
    return Specification(
        bandwidth_Hz=bandwidth_Hz,
        delay_margin_s=1.0 / RATE_Hz,
        voltage_min_V=-10.0,
        voltage_max_V=10.0,
        sensor_noise_rms=1e-9,
        scan_frequency_Hz=10.0,
        disturbance_rms=0.35e-6,
    )


def default_limits(family: PlantFamily, disturbance_rms: float) -> Specification:
    """Return the default limits for drives of -10 to 10 V and 1 nm of sensor noise."""
    return default_specification(
        family,
        voltage_min_V=-10.0,
        voltage_max_V=10.0,
        sensor_noise_rms=1e-9,
        disturbance_rms=disturbance_rms,
    )


def vertical_specification(bandwidth_Hz: float = 300.0) -> Specification:
    """Return limits of Ms <= 5.8 dB and 1.2 samples of delay."""
    return replace(
        lateral_specification(bandwidth_Hz),
        modulus_margin=10.0 ** (-5.8 / 20.0),
        delay_margin_s=1.2 / RATE_Hz,
        sensor_noise_rms=1.8e-3,
        disturbance_rms=0.1,
    )


def poles(*sections: tuple[float, float | None]) -> Array:
    """Return values of z of (frequency, damping) sections at 20 kHz."""
    roots = [
        roots_of(from_roots(section_poles(Section(frequency_Hz=f, damping=zeta), RATE_Hz)))
        for f, zeta in sections
    ]
    return np.concatenate(roots)


def printed_observer_poles() -> tuple[Array, Array]:
    """Feedback (630 Hz, 0.9), 4 kHz, 8.5 kHz; observer (1200 Hz, 0.8), 800, 4200, 8600 Hz."""
    feedback = poles((630.0, 0.9), (4e3, None), (8.5e3, None))
    observer = poles((1200.0, 0.8), (800.0, None), (4200.0, None), (8600.0, None))
    return feedback, observer


def random_chain(rng: np.random.Generator) -> Chain:
    """Draw one to three sections, a gain over ten decades and any delay up to three samples."""
    sections = [Section(frequency_Hz=float(rng.uniform(2e3, 9e3)))]
    if rng.uniform() < 0.7:
        mode = float(rng.uniform(200.0, 3e3))
        sections.append(Section(frequency_Hz=mode, damping=float(rng.uniform(0.01, 0.9))))
    if rng.uniform() < 0.5:
        sections.append(Section(frequency_Hz=float(rng.uniform(300.0, 1500.0))))
    return Chain(
        label="random",
        sampling_rate_Hz=RATE_Hz,
        gain=float(10.0 ** rng.uniform(-7, 3)),
        output_unit="m",
        sections=tuple(sections),
        delay_s=float(rng.uniform(0.0, 3.0)) / RATE_Hz,
    )


def loop(frequency_Hz: float, damping: float) -> tuple[Array, Array]:
    """Return R and S of the vertical axis for the target of ``LOOPS``."""
    dominant = Section(frequency_Hz=frequency_Hz, damping=damping)
    target = closed_loop_target(dominant, RATE_Hz, auxiliary_root=0.2, auxiliary_count=2)
    c = place_poles(plant_from_chain(vertical_chain()), target, H_R=[1.0, 1.0])
    return c.R, c.S
