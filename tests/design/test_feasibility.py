"""What can be held is designed; what cannot is refused with the nearest that can."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.design import LoopDesign
from piezoid.design.feasibility import (
    at_feasible_bandwidth,
    nearest_feasible_Hz,
    noise_rms,
    refuse,
    unmet,
)
from piezoid.design.junction_task import design_vertical
from piezoid.design.lateral import design_lateral
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import Template, Violation
from piezoid.design.specification import Specification, default_specification
from piezoid.design.tuning import tune_observer
from piezoid.errors import TemplateError
from tests.design.placed import plant_from_fraction
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
    free = tune_observer(family, lateral_specification(40.0), model=lateral_model()).controller
    whole = max(noise_rms(m, free.R, free.S, lateral_specification()) for m in family.members)
    asked = replace(lateral_specification(40.0), noise_limit_rms=0.8 * whole)
    quiet = tune_observer(family, asked, model=lateral_model())
    assert not quiet.violations
    hopeless = replace(asked, noise_limit_rms=1e-3 * whole)
    R, S = quiet.controller.R, quiet.controller.S
    assert unmet(family.members, R, S, hopeless)[0].template == "noise budget"


def ends_of_the_family() -> PlantFamily:
    nominal, *_, high = vertical_family().members
    return PlantFamily(members=(nominal, high))


def refused(asked: Specification) -> TemplateError:
    with pytest.raises(TemplateError) as refusal:
        design_vertical("z", ends_of_the_family(), asked)
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
    found = design_vertical("z", ends_of_the_family(), nearest)
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
        family,
        voltage_min_V=-10.0,
        voltage_max_V=10.0,
        sensor_noise_rms=1e-9,
        disturbance_rms=1e-7,
    )
    loop = design_lateral("x", {"inverse": family}, asked).recommended
    assert not unmet(loop.members, loop.R, loop.S, asked)
    assert loop.reference.error < 1e-3


def missed(*excesses_dB: float) -> tuple[Violation, ...]:
    return tuple(
        Violation(
            template=f"t{k % 2}",
            member="m",
            frequency_Hz=1.0,
            found=1.0,
            limit=1.0,
            unit="dB",
            excess_dB=excess_dB,
        )
        for k, excess_dB in enumerate(excesses_dB)
    )


def nearest_Hz(is_met: Callable[[float], bool], worst_dB: float = 6.0) -> float | None:
    """Bandwidth advised for 1 kHz where ``is_met`` says which can be."""
    asked = replace(lateral_specification(), bandwidth_Hz=1e3)

    def attempt(tried: Specification) -> tuple[Violation, ...]:
        return () if is_met(tried.bandwidth_Hz) else missed(worst_dB)

    return nearest_feasible_Hz(asked, missed(worst_dB), attempt)


@pytest.mark.parametrize("worst_dB", [0.01, 6.0, 200.0])
@pytest.mark.parametrize("most_Hz", [11.0, 100.0, 480.0, 930.0])
def test_the_bandwidth_advised_is_just_below_the_largest_that_can_be_met(most_Hz, worst_dB):
    found_Hz = nearest_Hz(lambda f_Hz: f_Hz <= most_Hz, worst_dB)
    # Four bisections of at most two decades, and three digits.
    assert 0.99 * most_Hz * 100.0 ** (-1 / 16) <= found_Hz <= most_Hz


def test_what_is_advised_was_tried_and_met_where_feasibility_has_holes():
    """Between 300 and 500 Hz no number of three digits can be met, though others can."""
    tried_Hz = []

    def is_between(f_Hz: float) -> bool:
        return f_Hz < 500.0 and abs(f_Hz - round(f_Hz)) > 1e-6

    def is_met(f_Hz: float) -> bool:
        tried_Hz.append(f_Hz)
        return f_Hz < 300.0 or is_between(f_Hz)

    found_Hz = nearest_Hz(is_met)
    assert 290.0 < found_Hz < 300.0
    assert tried_Hz[-1] == pytest.approx(found_Hz)
    assert nearest_Hz(lambda f_Hz: f_Hz > 100.0 and is_between(f_Hz)) is None
    assert nearest_Hz(lambda _: False) is None


def test_a_default_nobody_asked_for_gives_way_to_the_nearest_feasible():
    family = PlantFamily(members=lateral_family().members[:2])

    def design(asked: Specification) -> LoopDesign:
        return design_lateral("x", {"inverse": family}, asked).recommended

    loop = at_feasible_bandwidth(design, lateral_specification(900.0))
    assert 100.0 < loop.bandwidth_Hz < 900.0
    assert loop.worst_modulus_margin >= 0.5


def test_every_template_has_to_give_way_by_its_worst_miss():
    with pytest.raises(TemplateError) as refusal:
        refuse("x", lateral_specification(), missed(5.0, 4.0, 3.0, 2.0), lambda _: ())
    assert refusal.value.numbers["relaxation_dB"] == {"t0": 5.0, "t1": 4.0}
