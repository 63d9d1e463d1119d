"""Band-stops, then convex steps, shape one controller for every member of a family."""

from dataclasses import replace

import numpy as np

from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import Template, margins
from piezoid.design.shaping import shape
from piezoid.design.youla import optimise
from tests.design.rig import vertical_family, vertical_specification


def test_shaping_only_the_nominal_plant_collapses_at_the_ends_of_the_family():
    family, asked = vertical_family(), vertical_specification()
    alone = PlantFamily(members=family.members[:1])
    start = shape(alone, asked)
    nominal = optimise(alone, asked, start.controller)
    c = nominal.controller
    assert not nominal.violations
    reached = [margins(member, c.R, c.S) for member in family.members]
    assert any(not m.is_stable or m.modulus_peak_dB > 10.0 for m in reached)


def test_convex_steps_keep_every_member_stable_and_gain():
    family, asked = vertical_family(), vertical_specification(200.0)
    start = shape(family, asked)
    once, found = (optimise(family, asked, start.controller, max_iterations=n) for n in (1, 8))
    assert found.figure < once.figure < 0.99 * start.figure
    for solution in (once, found):
        assert not solution.violations
    c = found.controller
    assert c.S[0] == 1.0
    assert abs(c.S.sum()) <= 1e-12  # the integrator is a factor
    assert abs(c.R @ (-1.0) ** np.arange(len(c.R))) <= 1e-12 * abs(c.R).max()


def test_band_stops_meet_a_template_that_pole_placement_alone_cannot():
    family = PlantFamily(members=vertical_family().members[:1])
    quiet = Template(
        name="quiet",
        function="Syp",
        frequency_Hz=np.array([1000.0, 1100.0]),
        upper_dB=np.array([-2.0, -2.0]),
    )
    asked = replace(vertical_specification(60.0), modulus_margin=0.6, templates=(quiet,))
    plain = shape(family, asked, max_band_stops=0)
    found = shape(family, asked)
    assert plain.violations[0].excess_dB > 1.0
    assert not found.violations
    assert 990.0 < found.parameters["stop_0_Hz"] < 1110.0
