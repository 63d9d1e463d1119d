"""What the search sees of a family on its coarse grid, by second routes."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.feasibility import noise_rms, unmet
from piezoid.design.loop_search import evaluate_loop, family_grid, worst_excess
from piezoid.design.plant import PlantFamily, plant_from_chain
from piezoid.design.sensitivity import closed_loop_polynomial, margins, sensitivities
from piezoid.numerics.polynomial import spectral_radius
from tests.design.rig import (
    LOOPS,
    lateral_specification,
    loop,
    vertical_chain,
    vertical_family,
    vertical_specification,
)


def test_the_searchs_grid_agrees_with_the_fine_check():
    family, asked = vertical_family(), vertical_specification(100.0)
    grid = family_grid(family, asked, count=2000)
    for frequency_Hz, damping in LOOPS:
        R, S = loop(frequency_Hz, damping)
        seen = worst_excess(grid, R, S)
        assert seen.excess_dB == evaluate_loop(grid, R, S).excess_dB
        reached = [margins(m, R, S) for m in family.members]
        if seen.excess_dB <= -0.01:
            assert not unmet(family.members, R, S, asked)
        if not all(m.is_stable for m in reached):
            assert seen.excess_dB > 20.0


def test_the_grid_counts_unstable_members():
    family = vertical_family()
    grid = family_grid(family, vertical_specification(100.0))
    R, S = loop(1e3, 0.9)
    counts = []
    for factor in (1.0, 8.0):
        seen = worst_excess(grid, factor * R, S)
        assert evaluate_loop(grid, factor * R, S).excess_dB == seen.excess_dB
        counts.append(seen.excess_dB > 50.0)
        unstable = [
            spectral_radius(closed_loop_polynomial(m, factor * R, S)) > 1.0 for m in family.members
        ]
        assert counts[-1] == any(unstable)
    assert counts == [False, True]


def test_predicted_noise_is_the_simulated_noise(rng):
    plant = plant_from_chain(vertical_chain())
    R, S = loop(1e3, 0.9)
    asked = lateral_specification()
    grid = family_grid(PlantFamily(members=(plant,)), asked, count=1000)
    n = 60_000
    noise = asked.sensor_noise_rms * rng.normal(size=n)
    P = closed_loop_polynomial(plant, R, S)
    through, y = np.convolve(plant.B, R), np.zeros(n)
    for k in range(20, n):
        recent = noise[k - len(through) + 1 : k + 1][::-1]
        y[k] = -through @ recent - P[1:] @ y[k - len(P) + 1 : k][::-1]
    measured = y[1000:].std()
    assert noise_rms(plant, R, S, asked) == pytest.approx(measured, rel=0.05)
    assert evaluate_loop(grid, R, S).noise_rms == pytest.approx(
        noise_rms(plant, R, S, asked), rel=0.02
    )


def test_what_is_predicted_of_a_scan_is_the_sum_over_its_harmonics():
    family, asked = vertical_family(), vertical_specification(100.0)
    R, S = loop(1e3, 0.9)
    found = evaluate_loop(family_grid(family, asked), R, S)
    odd = np.array([1, 3, 5, 7])  # of a triangle: those beyond are small
    left = [
        sensitivities(m, R, S, odd * asked.scan_frequency_Hz).Syp / odd for m in family.members
    ]
    worst = max(float(np.linalg.norm(part)) for part in left)
    assert found.disturbance_rms == pytest.approx(worst * asked.disturbance_rms)
    assert found.predicted_error >= max(found.disturbance_rms, found.noise_rms)


def test_steps_of_the_converter_make_noise_as_large_as_they_are():
    family = vertical_family()
    R, S = loop(1e3, 0.9)
    quiet = replace(vertical_specification(100.0), sensor_noise_rms=0.0)
    noise = [
        evaluate_loop(family_grid(family, replace(quiet, voltage_step_V=step_V)), R, S).noise_rms
        for step_V in (1e-3, 2e-3)
    ]
    assert noise[1] == pytest.approx(2.0 * noise[0])
    asked = replace(quiet, voltage_step_V=1e-3)
    worst = max(noise_rms(m, R, S, asked) for m in family.members)
    assert noise[0] == pytest.approx(worst, rel=0.05)
