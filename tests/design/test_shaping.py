"""Band-stops and convex steps shape a controller for every member of a family."""

from dataclasses import replace

import numpy as np

from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import Template
from piezoid.design.shaping import optimise, shape
from tests.design.rig import vertical_family, vertical_specification


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
