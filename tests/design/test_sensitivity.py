"""Margins and sensitivity functions against independent computations."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.feasibility import unmet
from piezoid.design.sensitivity import Template, delay_limit, margins, sensitivities
from piezoid.numerics.polynomial import delayed, product, spectral_radius, total
from tests.design.placed import plant_from_fraction
from tests.design.rig import (
    LOOPS,
    RATE_Hz,
    lateral_specification,
    loop,
    vertical_chain,
    vertical_family,
)

PLANT = plant_from_chain(vertical_chain())


@pytest.mark.parametrize(("frequency_Hz", "damping"), LOOPS)
def test_whole_samples_below_the_delay_margin_are_stable_and_above_unstable(frequency_Hz, damping):
    R, S = loop(frequency_Hz, damping)
    samples = margins(PLANT, R, S).delay_margin_s * RATE_Hz

    def radius(delay: int) -> float:
        return spectral_radius(total(product(PLANT.A, S), delayed(product(PLANT.B, R), delay)))

    assert radius(int(np.floor(samples))) < 1.0
    assert radius(int(np.ceil(samples))) > 1.0


@pytest.mark.parametrize(("frequency_Hz", "damping"), LOOPS)
def test_the_modulus_margin_is_the_distance_of_the_nyquist_curve_from_minus_one(
    frequency_Hz, damping
):
    R, S = loop(frequency_Hz, damping)
    z = np.exp(1j * np.linspace(1e-4, np.pi, 200_001))
    curve = np.polyval(np.convolve(PLANT.B, R)[::-1], 1 / z)
    curve = curve / np.polyval(np.convolve(PLANT.A, S)[::-1], 1 / z)
    distance = np.abs(1.0 + curve).min()
    assert margins(PLANT, R, S).modulus_margin == pytest.approx(distance, rel=1e-7)


def test_the_four_sensitivity_functions_are_consistent():
    R, S = loop(1e3, 0.9)
    f = np.geomspace(1.0, 9e3, 40)
    functions = sensitivities(PLANT, R, S, f)
    np.testing.assert_allclose(functions.Syp - functions.Syb, 1.0, atol=1e-12)
    q = np.exp(-2j * np.pi * f / RATE_Hz)
    g = np.polyval(PLANT.B[::-1], q) / np.polyval(PLANT.A[::-1], q)
    np.testing.assert_allclose(functions.Syb, g * functions.Sup, rtol=1e-11)
    np.testing.assert_allclose(functions.Syv, g * functions.Syp, rtol=1e-11)


def test_an_unstable_loop_has_no_margins():
    R, S = loop(3e3, 0.6)
    integrator = plant_from_fraction(
        "held", [0.0, 1.0], [1.0, -1.0], sampling_rate_Hz=RATE_Hz, output_unit="m"
    )
    # A gain five times too large, and an integrator without feedback.
    for result in (margins(PLANT, 5.0 * R, S), margins(integrator, [0.0], [1.0])):
        assert not result.is_stable
        assert (result.modulus_margin, result.delay_margin_s or 0.0) == (0.0, 0.0)


def test_a_loop_without_crossing_has_no_delay_margin():
    plant = plant_from_fraction(
        "p", [0.0, 1.0], [1.0, -0.5], sampling_rate_Hz=RATE_Hz, output_unit="m"
    )
    result = margins(plant, [0.1], [1.0])
    assert result.delay_margin_s is None
    assert result.is_stable


@pytest.mark.parametrize("delay", [0.5, 1.0, 1.7, 3.0])
def test_below_the_delay_limit_the_delay_margin_is_kept(delay):
    """The limit is sufficient, also for delays beyond a sample."""
    f = np.linspace(1.0, 0.5 * RATE_Hz, 4000)
    count = 0
    for frequency_Hz in np.geomspace(300.0, 5e3, 25):
        R, S = loop(frequency_Hz, 0.7)
        below = np.abs(sensitivities(PLANT, R, S, f).Syb) <= delay_limit(f, delay / RATE_Hz)
        if below.all():
            count += 1
            assert margins(PLANT, R, S).delay_margin_s >= delay / RATE_Hz
    assert count > 0


def test_a_violation_names_template_member_frequency_and_amount():
    family = vertical_family()
    R, S = loop(1e3, 0.9)
    limit = Template(
        name="ceiling",
        function="Syp",
        frequency_Hz=np.array([200.0, 400.0]),
        upper_dB=np.array([-10.0, -10.0]),
    )
    specification = replace(lateral_specification(), modulus_margin=0.6, delay_margin_s=1e-9)
    all_violations = unmet(family.members, R, S, specification, templates=[limit])
    worst = all_violations[0]
    assert (worst.template, worst.member) == ("ceiling", "0.25 eV")
    level = 20 * np.log10(
        abs(sensitivities(family.members[1], R, S, np.array([worst.frequency_Hz])).Syp[0])
    )
    assert worst.found == pytest.approx(level)
    assert worst.excess_dB == pytest.approx(level + 10.0)
    assert "ceiling of the member '0.25 eV'" in worst.sentence
    margin = next(v for v in all_violations if v.template == "modulus margin")
    assert (margin.member, margin.limit) == ("4 eV", 0.6)


def test_every_member_with_too_small_a_delay_margin_is_reported():
    members, (R, S) = vertical_family().members, loop(1e3, 0.9)
    margins_s = {m.label: margins(m, R, S).delay_margin_s for m in members}
    limit_s = 1.01 * sorted(margins_s.values())[1]
    specification = replace(lateral_specification(), modulus_margin=1e-3, delay_margin_s=limit_s)
    all_violations = unmet(members, R, S, specification, templates=[])
    expected = {label: s for label, s in margins_s.items() if s < limit_s}
    assert len(expected) == 2
    assert {v.member: v.found for v in all_violations} == pytest.approx(expected)
    assert {(v.template, v.limit, v.unit) for v in all_violations} == {
        ("delay margin", limit_s, "s")
    }


def test_a_sensitivity_peak_at_the_nyquist_frequency_is_located():
    plant = plant_from_fraction(
        "first", [0.0, 0.5], [1.0, -0.2], sampling_rate_Hz=RATE_Hz, output_unit="1"
    )
    # |1 + 0.5 z / (1 - 0.2 z)| at z = -1: 1 - 0.5 / 1.2
    result = margins(plant, [1.0], [1.0])
    assert result.modulus_margin == pytest.approx(1.0 - 0.5 / 1.2, rel=1e-3)
    assert result.modulus_Hz == pytest.approx(RATE_Hz / 2, rel=1e-2)
