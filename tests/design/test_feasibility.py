"""Feasible specifications are designed; others are refused with the nearest feasible one."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

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
from piezoid.design.specification import BEYOND, CONTROL_EFFORT, Specification
from piezoid.design.tuning import tune_observer
from piezoid.errors import TemplateError
from tests.design.placed import plant_from_fraction
from tests.design.rig import (
    LATERAL_m_per_V,
    RATE_Hz,
    default_limits,
    lateral_family,
    lateral_model,
    lateral_specification,
    vertical_family,
    vertical_specification,
)

pytestmark = pytest.mark.usefixtures("brief_designs")


def test_a_noise_budget_is_met_or_refused():
    family = PlantFamily(members=lateral_family().members[:2])
    unlimited = tune_observer(
        family, lateral_specification(40.0), model=lateral_model()
    ).controller
    noise_m = max(
        noise_rms(m, unlimited.R, unlimited.S, lateral_specification()) for m in family.members
    )
    specification = replace(lateral_specification(40.0), noise_limit_rms=0.8 * noise_m)
    limited = tune_observer(family, specification, model=lateral_model())
    assert not limited.violations
    infeasible = replace(specification, noise_limit_rms=1e-3 * noise_m)
    R, S = limited.controller.R, limited.controller.S
    assert unmet(family.members, R, S, infeasible)[0].template == "noise budget"


def extreme_members() -> PlantFamily:
    nominal, *_, high = vertical_family().members
    return PlantFamily(members=(nominal, high))


def refusal_of(specification: Specification) -> TemplateError:
    with pytest.raises(TemplateError) as refusal:
        design_vertical("z", extreme_members(), specification)
    return refusal.value


def test_an_infeasible_bandwidth_is_refused_with_the_nearest_feasible_one():
    error = refusal_of(vertical_specification(900.0))
    numbers = error.numbers
    assert numbers["template"] in str(error)
    assert numbers["member"] in str(error)
    assert numbers["excess_dB"] > 0
    assert 300.0 < numbers["nearest_bandwidth_Hz"] < 900.0
    assert f"bandwidth_Hz = {numbers['nearest_bandwidth_Hz']:g}" in str(error)
    assert error.exit_status == 4
    nearest = vertical_specification(numbers["nearest_bandwidth_Hz"])
    design = design_vertical("z", extreme_members(), nearest)
    assert not unmet(
        design.recommended.members, design.recommended.R, design.recommended.S, nearest
    )


def test_a_limit_that_no_bandwidth_meets_is_reported_as_such():
    wall = Template(
        name="wall",
        function="Syp",
        frequency_Hz=np.array([1.0, 9e3]),
        upper_dB=np.array([-6.0, -6.0]),  # Bode's integral forbids it
    )
    error = refusal_of(replace(vertical_specification(100.0), templates=(wall,)))
    assert "No bandwidth helps" in str(error)
    assert "relax 'wall' by" in str(error)
    assert error.numbers["nearest_bandwidth_Hz"] is None


@pytest.mark.parametrize(
    ("B", "A"),
    [
        ((0.0, 0.3), (1.0, -0.7)),  # a single lag
        ((0.0, 0.5, 0.2), (1.0, -0.6, -0.07)),  # a negative pole, as in fits
        ((0.0, 0.0, 0.1, 0.02), (1.0, -0.9)),  # fractional delay
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
    specification = default_limits(family, disturbance_rms=1e-7)
    loop = design_lateral("x", {"inverse": family}, specification).recommended
    assert not unmet(loop.members, loop.R, loop.S, specification)
    assert loop.reference.error < 1e-3


def violations_of(*excesses_dB: float) -> tuple[Violation, ...]:
    return tuple(
        Violation(
            template="bandwidth",
            member="m",
            frequency_Hz=1.0,
            found=1.0,
            limit=1.0,
            unit="dB",
            excess_dB=excess_dB,
        )
        for excess_dB in excesses_dB
    )


def nearest_Hz(is_met: Callable[[float], bool], worst_dB: float = 6.0) -> float | None:
    """Return the bandwidth advised instead of 1 kHz if ``is_met`` decides the feasibility."""
    specification = replace(lateral_specification(), bandwidth_Hz=1e3)

    def attempt(candidate: Specification) -> tuple[Violation, ...]:
        return () if is_met(candidate.bandwidth_Hz) else violations_of(worst_dB)

    return nearest_feasible_Hz(specification, violations_of(worst_dB), attempt)


@pytest.mark.parametrize("worst_dB", [0.01, 6.0, 200.0])
@pytest.mark.parametrize("limit_Hz", [11.0, 100.0, 480.0, 930.0])
def test_the_advised_bandwidth_is_just_below_the_largest_feasible_one(limit_Hz, worst_dB):
    advised_Hz = nearest_Hz(lambda f_Hz: f_Hz <= limit_Hz, worst_dB)
    # Four bisections of at most two decades, and three digits.
    assert 0.99 * limit_Hz * 100.0 ** (-1 / 16) <= advised_Hz <= limit_Hz


def test_the_advised_bandwidth_is_tried_where_feasibility_has_gaps():
    """Between 300 and 500 Hz, numbers of three digits are infeasible and others feasible."""
    trials_Hz = []

    def is_between(f_Hz: float) -> bool:
        return f_Hz < 500.0 and abs(f_Hz - round(f_Hz)) > 1e-6

    def is_met(f_Hz: float) -> bool:
        trials_Hz.append(f_Hz)
        return f_Hz < 300.0 or is_between(f_Hz)

    advised_Hz = nearest_Hz(is_met)
    assert 290.0 < advised_Hz < 300.0
    assert trials_Hz[-1] == pytest.approx(advised_Hz)
    assert nearest_Hz(lambda f_Hz: f_Hz > 100.0 and is_between(f_Hz)) is None
    assert nearest_Hz(lambda _: False) is None


def test_a_default_bandwidth_is_lowered_to_the_nearest_feasible_one():
    """The design is refused also somewhat below the largest bandwidth that is found feasible."""

    def attempt(specification: Specification) -> tuple[Violation, ...]:
        return () if specification.bandwidth_Hz <= 400.0 else violations_of(6.0)

    def design(specification: Specification) -> float:
        if specification.bandwidth_Hz > 330.0:
            refuse("x", specification, violations_of(6.0), attempt)
        return specification.bandwidth_Hz

    assert 300.0 < at_feasible_bandwidth(design, lateral_specification(900.0)) <= 330.0


def test_an_advised_margin_is_a_line_of_the_specification():
    (violation,) = violations_of(6.0)
    violation = replace(violation, template="modulus margin")
    with pytest.raises(TemplateError) as refusal:
        refuse("x", lateral_specification(), (violation,), lambda _: ())
    assert "set modulus_margin = 0.25" in str(refusal.value)  # half of 0.5


@pytest.mark.parametrize("limit", [BEYOND, CONTROL_EFFORT])
def test_the_worst_violations_are_stated_without_advice_beside_a_limit_without_a_key(limit):
    names = ("modulus margin", limit, "modulus margin")
    violations = [
        replace(violation, template=name)
        for violation, name in zip(violations_of(6.0, 2.0, 4.0), names, strict=True)
    ]
    with pytest.raises(TemplateError) as refusal:
        refuse("x", lateral_specification(), tuple(violations), lambda _: ())
    assert "modulus_margin" not in refusal.value.remedy
    assert f"'{limit}' (missed by 2.00 dB)" in refusal.value.remedy
    assert refusal.value.numbers["relaxation_dB"] == {"modulus margin": 6.0, limit: 2.0}
