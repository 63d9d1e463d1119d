"""Band-stops, then convex steps, shape one controller for every member of a family."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.feasibility import unmet
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
    assert not unmet(alone.members, c.R, c.S, asked)
    reached = [margins(member, c.R, c.S) for member in family.members]
    assert any(not m.is_stable or m.modulus_peak_dB > 10.0 for m in reached)


def test_each_convex_step_keeps_every_member_stable_and_gains():
    family, asked = vertical_family(), vertical_specification(200.0)
    start = shape(family, asked)
    found = optimise(family, asked, start.controller)
    # A step that gains less than a hundredth is the last, and is not taken.
    assert (np.array(found.history[1:]) < 0.99 * np.array(found.history[:-1])).all()
    assert found.history[0] == pytest.approx(start.rejection, rel=1e-2)
    assert found.excess_dB <= 0.0
    c = found.controller
    assert not unmet(family.members, c.R, c.S, asked)
    assert c.S[0] == 1.0
    assert abs(c.S.sum()) <= 1e-12  # the integrator is a factor
    assert abs(c.R @ (-1.0) ** np.arange(len(c.R))) <= 1e-12 * abs(c.R).max()


def test_what_a_convex_step_was_not_asked_it_meets_as_if_it_had_been():
    alone, asked = PlantFamily(members=vertical_family().members[:1]), vertical_specification()
    start = shape(alone, asked).controller
    few = optimise(alone, asked, start, max_iterations=2)
    every = optimise(alone, asked, start, max_iterations=2, every=1)
    assert few.history == pytest.approx(every.history, rel=1e-4)
    assert few.excess_dB == pytest.approx(every.excess_dB, abs=1e-3)


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
    assert plain.excess_dB > 1.0
    assert found.excess_dB <= 0.0
    assert {stop.part for stop in found.band_stops} == {"S"}
    assert all(990.0 < stop.frequency_Hz < 1110.0 for stop in found.band_stops)
    assert not unmet(family.members, found.controller.R, found.controller.S, asked)
