"""Band-stops and convex steps shape a loop for every member of a family; its predicted error."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.feasibility import noise_rms
from piezoid.design.loop_search import evaluate_loop, family_grid
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import Template, closed_loop_polynomial, sensitivities
from piezoid.design.shaping import optimise, shape
from tests.design.rig import (
    lateral_specification,
    loop,
    vertical_chain,
    vertical_family,
    vertical_specification,
)


def test_convex_steps_improve_the_figure_and_keep_every_member_stable():
    family, specification = vertical_family(), vertical_specification(200.0)
    start = shape(family, specification)
    after_one_step, optimised = (
        optimise(family, specification, start.controller, max_iterations=n) for n in (1, 8)
    )
    assert optimised.figure < after_one_step.figure < 0.99 * start.figure
    for solution in (after_one_step, optimised):
        assert not solution.violations
    c = optimised.controller
    assert c.S[0] == 1.0
    assert abs(c.S.sum()) <= 1e-12  # the integrator is a factor
    assert abs(c.R @ (-1.0) ** np.arange(len(c.R))) <= 1e-12 * abs(c.R).max()


def test_band_stops_meet_a_template_that_pole_placement_alone_cannot():
    family = PlantFamily(members=vertical_family().members[:1])
    template = Template(
        name="quiet",
        function="Syp",
        frequency_Hz=np.array([1000.0, 1100.0]),
        upper_dB=np.array([-2.0, -2.0]),
    )
    specification = replace(
        vertical_specification(60.0), modulus_margin=0.6, templates=(template,)
    )
    placed = shape(family, specification, max_band_stops=0)
    shaped = shape(family, specification)
    assert placed.violations[0].excess_dB > 1.0
    assert not shaped.violations
    assert 990.0 < shaped.parameters["stop_0_Hz"] < 1110.0


@pytest.mark.parametrize(("sensor", "step_V"), [(1e-9, 0.0), (0.0, 1e-3)])
def test_predicted_noise_is_the_simulated_noise(sensor, step_V, rng):
    """White noise of the sensor at the output, or of converter steps at the input."""
    plant = plant_from_chain(vertical_chain())
    R, S = loop(1e3, 0.9)
    specification = replace(
        lateral_specification(),
        sensor_noise_rms=sensor,
        voltage_step_V=step_V,
        disturbance_rms=0.0,
    )
    n = 60_000
    noise = (sensor or step_V / np.sqrt(12.0)) * rng.normal(size=n)
    P = closed_loop_polynomial(plant, R, S)
    y = lfilter(np.convolve(plant.B, R if sensor else S), P, noise)
    assert noise_rms(plant, R, S, specification) == pytest.approx(y[1000:].std(), rel=0.05)
    grid = family_grid(PlantFamily(members=(plant,)), specification, count=1000)
    predicted = evaluate_loop(grid, R, S).predicted_error
    assert predicted == pytest.approx(noise_rms(plant, R, S, specification), rel=0.02)


def test_the_predicted_error_of_a_scan_is_the_sum_over_harmonics():
    family, specification = vertical_family(), vertical_specification(100.0)
    specification = replace(specification, sensor_noise_rms=0.0)
    R, S = loop(1e3, 0.9)
    evaluation = evaluate_loop(family_grid(family, specification), R, S)
    odd = np.array([1, 3, 5, 7])  # harmonics of a triangle; higher ones are negligible
    sensitivity_by_member = [
        sensitivities(m, R, S, odd * specification.scan_frequency_Hz).Syp / odd
        for m in family.members
    ]
    worst = max(float(np.linalg.norm(sensitivity)) for sensitivity in sensitivity_by_member)
    assert evaluation.predicted_error == pytest.approx(worst * specification.disturbance_rms)
