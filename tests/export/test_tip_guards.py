"""A tunnelling axis ships with its guards, or not at all."""

import math
from dataclasses import replace

import pytest
from msgspec import structs

from piezoid.design.junction_task import vertical_task
from piezoid.errors import LabFileError
from piezoid.export.tip_guards import extension_m_per_V, tip_guards
from piezoid.identification.tunnelling.junction import TunnellingModel
from tests.design.junction_lab import LAB, loop_plant
from tests.design.rig import NEPER_PER_V, RATE_Hz

ASKED = vertical_task(TunnellingModel(gap_law=None, loop_plant=loop_plant()), LAB)[1]


def guards(**changed: float | None):
    lab = replace(LAB, tunnelling=structs.replace(LAB.tunnelling, **changed))
    return tip_guards(lab, ASKED, RATE_Hz, loop_plant())


def test_a_tip_that_nobody_says_otherwise_of_retracts_to_the_lowest_command() -> None:
    found = guards()
    assert found["retract_voltage_V"] == ASKED.voltage_min_V
    assert (found["retract_samples"], found["bad_samples"]) == (200, 20)
    assert guards(retract_V=-3.0)["retract_voltage_V"] == -3.0


def test_the_sign_of_the_bias_is_not_the_runtimes_business() -> None:
    assert guards(set_point_A=-1e-9)["current_reference_A"] == 1e-9


@pytest.mark.parametrize("name", ["set_point_A", "floor_A", "ceiling_A"])
def test_a_missing_guard_is_refused_with_the_line_to_write(name: str) -> None:
    with pytest.raises(LabFileError, match=rf"`{name} = .*` under \[tunnelling\]"):
        guards(**{name: None})


@pytest.mark.parametrize(
    "changed", [{"floor_A": 2e-9}, {"ceiling_A": 5e-10}, {"retract_V": -11.0}, {"retract_V": 10.5}]
)
def test_guards_that_guard_nothing_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(LabFileError, match="export again"):
        guards(**changed)


def test_a_ceiling_that_cannot_be_read_is_refused() -> None:
    with pytest.raises(LabFileError, match="read at most 1e-08 A"):
        guards(ceiling_A=1e-6)


def test_a_range_that_does_not_hold_the_set_point_is_that_of_the_drive_alone() -> None:
    assert guards(set_point_A=2e-8, ceiling_A=1e-7)["current_ceiling_A"] == 1e-7


def test_the_approach_grows_by_a_quarter_of_the_way_until_the_loop_answers() -> None:
    """K v N = ln(9) / 4: delay 60 us, poles of 4 and 9 kHz, two samples; a gain of twice K."""
    found = guards()
    samples = (6e-5 + (1 / 4e3 + 1 / 9e3) / (2 * math.pi)) * RATE_Hz + 2
    grown = found["approach_step_V"] * 2.0 * NEPER_PER_V * samples
    assert grown == pytest.approx(math.log(9.0) / 4)
    assert found["approach_log_step"] * samples == pytest.approx(math.log(9.0) / 4)
    assert found["contact_log"] == pytest.approx(math.log(9.0) / 3)


def test_a_ceiling_nearer_to_the_set_point_makes_the_approach_slower() -> None:
    assert guards(ceiling_A=2e-9)["approach_step_V"] == pytest.approx(
        guards()["approach_step_V"] * math.log(2.0) / math.log(9.0)
    )


def test_the_laboratory_may_ask_for_a_slower_approach_and_for_no_faster_one() -> None:
    extension = extension_m_per_V(loop_plant())
    speed = guards()["approach_step_V"] * extension * RATE_Hz
    half = guards(approach_m_per_s=speed / 2)
    assert half["approach_step_V"] == pytest.approx(guards()["approach_step_V"] / 2)
    with pytest.raises(LabFileError, match="responds in time"):
        guards(approach_m_per_s=1.01 * speed)


def test_distances_become_volts_by_the_extension() -> None:
    found, extension = guards(retract_m=2e-9, search_m=1e-9), extension_m_per_V(loop_plant())
    assert found["retract_step_V"] == pytest.approx(2e-9 / extension)
    assert found["search_voltage_V"] == pytest.approx(1e-9 / extension)


def test_a_sensor_is_watched_for_as_long_as_its_noise_needs_to_move_it() -> None:
    """0.42 pA of Johnson noise in steps of 0.3 pA; and steps of 78 pA that nothing moves."""
    assert guards()["stuck_samples"] == 20
    assert guards()["stuck_current_A"] == -1.0
    eight_bits = structs.replace(LAB.acquisition, dac_bits=8, adc_bits=8)
    coarse = replace(LAB, acquisition=eight_bits)
    found = tip_guards(coarse, ASKED, RATE_Hz, loop_plant())
    assert found["stuck_samples"] == 200
    assert found["stuck_current_A"] == found["current_floor_A"]
