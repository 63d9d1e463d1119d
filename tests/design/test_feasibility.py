"""What can be held is designed; what cannot is refused with the nearest that can."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.design import LoopDesign
from piezoid.design.feasibility import at_feasible_bandwidth
from piezoid.design.lateral import design_lateral
from piezoid.design.observer_loop import linear_controller
from piezoid.design.plant import PlantFamily, plant_from_fraction
from piezoid.design.requirements import unmet
from piezoid.design.specification import Specification, default_specification
from piezoid.design.templates import Template
from piezoid.design.tuning import tune_observer
from piezoid.design.vertical import design_vertical
from piezoid.errors import TemplateError
from tests.design.rig import (
    LATERAL_m_per_V,
    RATE_Hz,
    lateral_family,
    lateral_model,
    lateral_specification,
    vertical_family,
    vertical_specification,
)


def test_the_noise_budget_is_held_or_refused():
    family = PlantFamily(members=lateral_family().members[:2])
    free = tune_observer(family, lateral_specification(40.0), model=lateral_model())
    asked = replace(lateral_specification(40.0), noise_limit_rms=0.8 * free.judgement.noise_rms)
    quiet = tune_observer(family, asked, model=lateral_model())
    c = linear_controller(quiet.observer)
    assert not unmet(family.members, c.R, c.S, asked)
    hopeless = replace(asked, noise_limit_rms=1e-3 * free.judgement.noise_rms)
    assert unmet(family.members, c.R, c.S, hopeless)[0].template == "noise budget"


def ends_of_the_family() -> PlantFamily:
    nominal, low, *_, high = vertical_family().members
    return PlantFamily(members=(nominal, low, high))


def refused(asked: Specification) -> TemplateError:
    with pytest.raises(TemplateError) as refusal:
        design_vertical("z", ends_of_the_family(), asked, taps=8)
    return refusal.value


def test_an_infeasible_bandwidth_is_refused_with_the_place_and_the_nearest_one():
    error = refused(vertical_specification(1500.0))
    numbers = error.numbers
    assert numbers["template"] in str(error)
    assert numbers["member"] in str(error)
    assert numbers["excess_dB"] > 0
    assert 300.0 < numbers["nearest_bandwidth_Hz"] < 1500.0
    assert f"bandwidth_Hz = {numbers['nearest_bandwidth_Hz']:g}" in str(error)
    assert error.exit_status == 4
    nearest = vertical_specification(numbers["nearest_bandwidth_Hz"])
    found = design_vertical("z", ends_of_the_family(), nearest, taps=8)
    assert not unmet(found.recommended.members, found.recommended.R, found.recommended.S, nearest)


def test_a_limit_no_bandwidth_can_meet_is_said_to_be_one():
    wall = Template(
        name="wall",
        function="Syp",
        frequency_Hz=np.array([1.0, 9e3]),
        upper_dB=np.array([-6.0, -6.0]),  # Bode's integral forbids it
    )
    error = refused(replace(vertical_specification(100.0), templates=(wall,)))
    assert "No bandwidth helps" in str(error)
    assert "relax 'wall' by" in str(error)
    assert error.numbers["nearest_bandwidth_Hz"] is None


@pytest.mark.parametrize(
    ("B", "A"),
    [
        ((0.0, 0.3), (1.0, -0.7)),  # one lag
        ((0.0, 0.5, 0.2), (1.0, -0.6, -0.07)),  # a negative pole, as fits give
        ((0.0, 0.0, 0.1, 0.02), (1.0, -0.9)),  # broken delay
    ],
)
def test_identified_fractions_are_designed_with_their_defaults(B, A):
    members = [
        plant_from_fraction(
            f"gain x{gain}",
            gain * LATERAL_m_per_V * np.array(B),
            A,
            sampling_rate_Hz=RATE_Hz,
            output_unit="m",
        )
        for gain in (1.0, 0.9, 1.1)
    ]
    family = PlantFamily(members=tuple(members))
    asked = default_specification(
        family.nominal,
        voltage_min_V=-10.0,
        voltage_max_V=10.0,
        sensor_noise_rms=1e-9,
        disturbance_rms=1e-7,
    )
    loop = design_lateral("x", {"inverse": family}, asked).recommended
    assert not unmet(loop.members, loop.R, loop.S, asked)
    assert loop.reference.error < 1e-3


def test_a_default_nobody_asked_for_gives_way_to_the_nearest_feasible():
    family = PlantFamily(members=lateral_family().members[:2])

    def design(asked: Specification) -> LoopDesign:
        return design_lateral("x", {"inverse": family}, asked).recommended

    loop = at_feasible_bandwidth(design, lateral_specification(900.0))
    assert 100.0 < loop.bandwidth_Hz < 900.0
    assert loop.worst_modulus_margin >= 0.5
