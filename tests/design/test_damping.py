"""Loops that damp a mode at 700 Hz of quality 40, whose frequency is known to 10 %."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import cont2discrete

from benchmarks.varied_chains import Chain, family_from_chains, varied
from piezoid.design.certificate import Certificate
from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.design.lateral import damped_mode, describe_mode, design_lateral, raise_bandwidth
from piezoid.design.plant import PlantFamily, Section
from piezoid.design.rst import ringing_mode
from piezoid.design.specification import Specification
from piezoid.errors import TemplateError
from piezoid.export.export_stage import observer_values
from piezoid.numerics.arrays import Array
from tests.design.rig import SECTOR, default_limits
from tests.design.test_runtime_agreement import LIMITS
from tests.runtime.runtime_parameters import started

pytestmark = pytest.mark.usefixtures("brief_designs")

RATE_Hz = 20e3
GAIN_m_per_V = 1e-6
MODE_Hz, DAMPING = 700.0, 0.0125
BANDWIDTH_Hz = 500.0
SLOPES = replace(SECTOR, form="inverse", gain_m_per_V=GAIN_m_per_V, slope_min=0.4, slope_max=1.6)


def family(spread: float = 0.1, mode_Hz: float = MODE_Hz, members: int = 9) -> PlantFamily:
    chain = Chain(
        label="nominal",
        sampling_rate_Hz=RATE_Hz,
        gain=GAIN_m_per_V,
        output_unit="m",
        sections=(Section(frequency_Hz=mode_Hz, damping=DAMPING),),
        delay_s=1.0 / RATE_Hz,
    )
    factors = np.linspace(1.0 - spread, 1.0 + spread, members).tolist()
    return family_from_chains(chain, [varied(chain, mode_factor=k) for k in factors if k != 1.0])


def default_of(plants: PlantFamily) -> Specification:
    return default_limits(plants, disturbance_rms=2e-8)


def design(plants: PlantFamily, specification: Specification) -> AxisDesign:
    return design_lateral("x", {"inverse": plants}, specification, bounds={"inverse": SLOPES})


@pytest.fixture(scope="module")
def loop() -> LoopDesign:
    plants = family()
    return design(plants, replace(default_of(plants), bandwidth_Hz=BANDWIDTH_Hz)).recommended


def tone_attenuation(loop: LoopDesign, mode_Hz: float, tone_Hz: float) -> float:
    """Return the attenuation of a tone by the shipped C on an independently sampled stage."""
    assert loop.observer is not None
    values = {**LIMITS, **observer_values(loop.observer), "method": "dob"}
    controller = started(values)
    w = 2.0 * np.pi * mode_Hz
    system = [[0.0, 1.0], [-(w**2), -2.0 * DAMPING * w]], [[0.0], [w**2]], [[1.0, 0.0]], [[0.0]]
    A, B, C, _, _ = cont2discrete(tuple(map(np.array, system)), 1.0 / RATE_Hz)
    x, delayed_V = np.zeros(2), 0.0
    k = np.arange(6000)
    tone = 1e-8 * np.sin(2.0 * np.pi * tone_Hz * k / RATE_Hz)
    position = np.empty(len(k))
    for now in k:
        position[now] = float(C[0] @ x) * GAIN_m_per_V + tone[now]
        voltage_V = controller.step(0.0, position[now])
        x, delayed_V = A @ x + B[:, 0] * delayed_V, voltage_V
    return _amplitude(position[-4000:], tone_Hz) / _amplitude(tone[-4000:], tone_Hz)


def _amplitude(signal: Array, tone_Hz: float) -> float:
    turn = np.exp(-2j * np.pi * tone_Hz * np.arange(len(signal)) / RATE_Hz)
    return float(np.abs(signal @ turn))


@pytest.mark.parametrize("factor", [0.9, 0.962, 1.0, 1.1])
def test_the_controller_attenuates_at_its_bandwidth_for_any_mode(loop, factor):
    attenuation = tone_attenuation(loop, factor * MODE_Hz, BANDWIDTH_Hz)
    assert attenuation < 10.0 ** (-3.0 / 20.0) + 1e-3
    assert attenuation > 0.3  # the tone reaches the position


def test_the_margins_hold_between_the_members(loop):
    """The interval has 81 modes that are not members, on a fine grid of frequencies."""
    z = np.exp(1j * np.linspace(1e-4, np.pi, 20_001))
    r, s = np.polyval(loop.R[::-1], 1.0 / z), np.polyval(loop.S[::-1], 1.0 / z)
    for factor in np.linspace(0.9, 1.1, 81).tolist():
        w = 2.0 * np.pi * factor * MODE_Hz
        continuous = ([w**2 * GAIN_m_per_V], [1.0, 2.0 * DAMPING * w, w**2])
        b, a, _ = cont2discrete(continuous, 1.0 / RATE_Hz)
        plant = np.polyval(b[0], z) / np.polyval(a, z) / z  # one sample of delay
        assert np.abs(1.0 + plant * r / s).min() > 0.499


def test_a_loop_states_the_damping_before_and_after(loop):
    damping = damped_mode(loop)
    assert damping is not None
    assert damping > 5.0 * DAMPING
    assert "damped by state feedback, from a damping ratio of 0.0125 to 0.1" in describe_mode(loop)
    assert any("damped by state feedback" in c.name for c in loop.candidates if c.is_chosen)


def test_a_default_bandwidth_is_raised_while_the_certificate_holds():
    plants = PlantFamily(members=family(0.02, members=2).members[:2])
    specification = default_of(plants)
    original = design(plants, specification)
    raised = raise_bandwidth(
        original, plants, specification, lambda s: design(plants, s), form="inverse"
    ).recommended
    assert original.recommended.bandwidth_Hz < 0.16 * MODE_Hz
    assert raised.bandwidth_Hz > 2.0 * original.recommended.bandwidth_Hz
    assert raised.worst_modulus_margin >= 0.5
    assert isinstance(raised.certificate, Certificate)
    assert raised.certificate.is_guaranteed
    unproven = replace(original.recommended, certificate=None)
    unproven_design = replace(original, loops=(unproven,))
    assert (
        raise_bandwidth(
            unproven_design, plants, specification, lambda s: design(plants, s), form="inverse"
        )
        is unproven_design
    )


def test_a_mode_with_too_much_delay_is_refused_with_its_phase():
    plants = family(mode_Hz=4000.0, members=2)
    mode = ringing_mode(plants.nominal)
    assert mode is not None
    assert mode.frequency_Hz == pytest.approx(4000.0)
    with pytest.raises(TemplateError, match=r"by 75.0 µs, which is 108°.*bandwidth_Hz = "):
        design(plants, replace(default_of(plants), bandwidth_Hz=900.0))
