"""Plants from physical numbers and from fractions, and families."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.plant import Chain, PlantFamily, Section, plant_from_chain
from piezoid.numerics.polynomial import response
from tests.design.placed import plant_from_fraction
from tests.design.rig import LATERAL_m_per_V, RATE_Hz, lateral_chain, random_chain, vertical_chain

PRINTED = 5.1e-11


def test_the_lateral_plant_has_its_printed_coefficients():
    plant = plant_from_chain(lateral_chain())
    np.testing.assert_allclose(
        plant.A, (1, -2.2955789143, 1.6871659856, -0.3851608527, 0.0193167468), atol=PRINTED
    )
    np.testing.assert_allclose(
        plant.B, (0, 0.002703629761, 0.015538017175, 0.007243715667, 0.000257602780), atol=5.1e-13
    )


def test_the_gain_at_rest_is_the_chains(rng):
    for _ in range(20):
        chain = random_chain(rng)
        plant = plant_from_chain(chain)
        assert plant.gain == pytest.approx(chain.gain, rel=1e-9)
        assert np.abs(plant.poles).max() < 1.0


def test_a_pole_that_float64_cannot_see_leaves_no_state():
    assert len(plant_from_chain(vertical_chain()).A) == 3  # 120 kHz at 20 kHz: exp(-37.7)
    slower = Chain(
        label="s",
        sampling_rate_Hz=RATE_Hz,
        gain=1.0,
        output_unit="m",
        sections=(Section(frequency_Hz=110e3),),
    )
    assert len(plant_from_chain(slower).A) == 2
    with pytest.raises(ValueError, match="no section is slow enough"):
        plant_from_chain(replace(slower, sections=(Section(frequency_Hz=120e3),)))


def test_a_numerator_without_its_delay_is_refused():
    with pytest.raises(ValueError, match="answers one sample late"):
        plant_from_fraction("p", [1.0], [1.0, -0.5], sampling_rate_Hz=RATE_Hz, output_unit="m")


def test_a_family_shares_rate_and_unit():
    metres = plant_from_chain(lateral_chain(LATERAL_m_per_V))
    with pytest.raises(ValueError, match="differ in rate"):
        PlantFamily(members=(metres, plant_from_chain(vertical_chain())))
    with pytest.raises(ValueError, match="at least its nominal"):
        PlantFamily(members=())


@pytest.mark.parametrize(("frequency_Hz", "damping"), [(0.0, None), (100.0, 0.0)])
def test_a_section_without_frequency_or_damping_is_refused(frequency_Hz, damping):
    with pytest.raises(ValueError, match="positive frequency and damping"):
        Section(frequency_Hz=frequency_Hz, damping=damping)


def test_a_delay_as_a_late_pole_is_the_same_plant_to_a_slow_loop() -> None:
    exact = plant_from_chain(replace(lateral_chain(), delay_s=30.5 / RATE_Hz))
    short = exact.with_delay_pole(25)
    assert len(short.realised()[0]) == len(exact.realised()[0]) - 24
    assert short.delay_samples == exact.delay_samples - 25
    assert short.gain == pytest.approx(exact.gain, rel=1e-9)
    place_Hz = np.array([1.0, 30.0, 300.0])
    a, b = (response(p.B, p.A, place_Hz, RATE_Hz) for p in (exact, short))
    turned = 2.0 * np.pi * place_Hz * 25 / RATE_Hz  # by the samples that became a pole
    assert (np.abs(b / a - 1.0)[:2] < 0.6 * turned[:2] ** 2).all()
    A, B, C = short.realised()
    z = np.exp(2j * np.pi * place_Hz[2] / RATE_Hz)
    through_states = C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
    assert through_states == pytest.approx(b[2])
