"""Pole placement: the worked example to its printed digits, and random plants."""

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.plant import Section
from piezoid.design.rst import OPEN_AT_NYQUIST, RstController, closed_loop_target, place_poles
from piezoid.design.sensitivity import closed_loop_polynomial, margins, sensitivities
from piezoid.design.shaping import band_stop_polynomials
from piezoid.errors import DesignError, UnstableLoopError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import product, total
from tests.design.rig import RATE_Hz, random_chain, vertical_chain

PRINTED = 5.1e-11  # half of the tenth decimal


def example(*, p_extra: Array | None = None, s_extra: Array | None = None) -> RstController:
    target = closed_loop_target(
        Section(frequency_Hz=1e3, damping=0.9), RATE_Hz, auxiliary_root=0.2, auxiliary_count=2
    )
    unit = np.ones(1)
    return place_poles(
        plant_from_chain(vertical_chain()),
        product(target, unit if p_extra is None else p_extra),
        H_R=OPEN_AT_NYQUIST,
        H_S=product([1.0, -1.0], unit if s_extra is None else s_extra),
    )


def test_the_worked_example_has_its_printed_coefficients():
    plant, c = plant_from_chain(vertical_chain()), example()
    np.testing.assert_allclose(plant.A, (1, -0.3278234616, 0.0122990935), atol=PRINTED)
    np.testing.assert_allclose(plant.B, (0, 0, 102.2579562477, 23.9785156002), atol=PRINTED)
    P = closed_loop_polynomial(plant, c.R, c.S)
    np.testing.assert_allclose(
        P[:5], (1, -1.8933146795, 1.2054094777, -0.2869660295, 0.0227233442), atol=PRINTED
    )
    assert np.abs(P[5:]).max() <= 1e-15
    np.testing.assert_allclose(
        c.S, (1, -1.5654912179, 0.6523716392, -0.0792887741, -0.0075916473), atol=PRINTED
    )
    np.testing.assert_allclose(
        c.R, (2.692602e-4, 1.856397e-4, -7.97265e-5, 3.8939e-6), atol=5.1e-11
    )
    assert c.T[0] == pytest.approx(3.790672551e-4, abs=5.1e-14)


def test_the_worked_example_has_its_printed_margins():
    plant, c = plant_from_chain(vertical_chain()), example()
    result = margins(plant, c.R, c.S)
    assert result.modulus_peak_dB == pytest.approx(2.80, abs=0.005)
    assert result.modulus_margin == pytest.approx(0.724, abs=0.0005)
    # The printed 9.11 comes from a grid; the exact crossing is at 416.47 Hz.
    assert result.delay_margin_s * RATE_Hz == pytest.approx(9.11, abs=0.05)
    at_315 = abs(sensitivities(plant, c.R, c.S, np.array([315.0])).Syp[0])
    assert 20 * np.log10(at_315) == pytest.approx(-3.0, abs=0.05)


def test_the_printed_band_stop_attenuates_as_printed():
    numerator, denominator = band_stop_polynomials(300.0, 0.2, RATE_Hz)
    np.testing.assert_allclose(numerator, (1, -1.954340001, 0.9630520957), atol=5.1e-10)
    np.testing.assert_allclose(denominator, (1, -1.8517145433, 0.8599691522), atol=PRINTED)
    plant = plant_from_chain(vertical_chain())
    c = example(p_extra=denominator, s_extra=numerator)
    without_stop, with_stop = (
        abs(sensitivities(plant, x.R, x.S, np.array([300.0])).Syp[0]) for x in (example(), c)
    )
    assert without_stop == pytest.approx(0.677, abs=0.001)
    assert with_stop == pytest.approx(0.221, abs=0.001)
    result = margins(plant, c.R, c.S)
    assert result.modulus_peak_dB == pytest.approx(3.98, abs=0.01)
    assert result.delay_margin_s * RATE_Hz == pytest.approx(4.3, abs=0.05)


def test_200_random_plants_are_placed_to_1e_10_with_fixed_parts(rng):
    max_error = 0.0
    for _ in range(200):
        plant = plant_from_chain(random_chain(rng))
        w = 2.0 * np.pi * rng.uniform(40.0, 400.0) / RATE_Hz
        hum = [1.0, -2.0 * np.cos(w), 1.0] if rng.uniform() < 0.4 else [1.0]
        h_s = product([1.0, -1.0], hum)
        h_r = OPEN_AT_NYQUIST if rng.uniform() < 0.7 else np.ones(1)
        dominant = Section(
            frequency_Hz=float(rng.uniform(200, 2e3)), damping=float(rng.uniform(0.5, 1.2))
        )
        target = closed_loop_target(
            dominant, RATE_Hz, auxiliary_root=float(rng.uniform(0.05, 0.5)), auxiliary_count=2
        )
        c = place_poles(plant, target, H_R=h_r, H_S=h_s)
        error = total(np.convolve(plant.A, c.S), np.convolve(plant.B, c.R), -target)
        max_error = max(max_error, float(np.abs(error).max() / np.abs(target).max()))
        for fixed, polynomial in ((h_s, c.S), (h_r, c.R)):
            values = np.polyval(polynomial[::-1], 1.0 / np.roots(fixed))
            assert np.abs(values).max(initial=0.0) <= 1e-9 * np.abs(polynomial).max()
    assert max_error <= 1e-10


@pytest.mark.parametrize(("root", "message"), [(1.0, "magnitude 1"), (1.01, r"magnitude 1\.01")])
def test_a_target_that_is_not_stable_is_refused(root, message):
    with pytest.raises(UnstableLoopError, match=message):
        place_poles(plant_from_chain(vertical_chain()), np.array([1.0, -root]))


def test_a_zero_that_cancels_the_integrator_is_refused():
    with pytest.raises(DesignError, match="no common root"):
        place_poles(plant_from_chain(vertical_chain()), [1.0, -0.5], H_R=[1.0, -1.0])
