"""Guards of a tunnelling axis, which does not ship without them."""

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

SPECIFICATION = vertical_task(TunnellingModel(gap_law=None, loop_plant=loop_plant()), LAB)[1]


def guards(**overrides: float | None):
    lab = replace(LAB, tunnelling=structs.replace(LAB.tunnelling, **overrides))
    return tip_guards(lab, SPECIFICATION, RATE_Hz, loop_plant())


def test_the_runtime_gets_the_declared_guards():
    values = guards()
    assert values["retract_voltage_V"] == SPECIFICATION.voltage_min_V
    assert (values["retract_samples"], values["bad_samples"]) == (200, 20)
    assert guards(retract_V=-3.0)["retract_voltage_V"] == -3.0
    assert guards(set_point_A=-1e-9)["current_reference_A"] == 1e-9
    values, extension = guards(retract_m=2e-9, search_m=1e-9), extension_m_per_V(loop_plant())
    assert values["retract_step_V"] == pytest.approx(2e-9 / extension)
    assert values["search_voltage_V"] == pytest.approx(1e-9 / extension)


@pytest.mark.parametrize("name", ["set_point_A", "floor_A", "ceiling_A"])
def test_a_missing_guard_is_refused_with_the_line_to_write(name):
    with pytest.raises(LabFileError, match=rf"`{name} = .*` under \[tunnelling\]"):
        guards(**{name: None})


@pytest.mark.parametrize(
    "overrides",
    [{"floor_A": 2e-9}, {"ceiling_A": 5e-10}, {"retract_V": -11.0}, {"retract_V": 10.5}],
)
def test_ineffective_guards_are_refused(overrides):
    with pytest.raises(LabFileError, match="export again"):
        guards(**overrides)


def test_a_ceiling_beyond_the_range_of_the_sensor_is_refused():
    with pytest.raises(LabFileError, match="read at most 1e-08 A"):
        guards(ceiling_A=1e-6)
    assert guards(set_point_A=2e-8, ceiling_A=1e-7)["current_ceiling_A"] == 1e-7


def test_the_approach_changes_the_current_by_a_quarter_of_the_margin_within_the_delay():
    """K v N is ln(9) / 4 with a delay of 60 us, poles of 4 and 9 kHz, and a gain of 2 K."""
    values = guards()
    samples = (6e-5 + (1 / 4e3 + 1 / 9e3) / (2 * math.pi)) * RATE_Hz + 2
    log_change = values["approach_step_V"] * 2.0 * NEPER_PER_V * samples
    assert log_change == pytest.approx(math.log(9.0) / 4)
    assert values["approach_log_step"] * samples == pytest.approx(math.log(9.0) / 4)
    assert values["contact_log"] == pytest.approx(math.log(9.0) / 3)
    assert guards(ceiling_A=2e-9)["approach_step_V"] == pytest.approx(
        guards()["approach_step_V"] * math.log(2.0) / math.log(9.0)
    )


def test_a_declared_approach_may_be_slower_but_not_faster():
    extension = extension_m_per_V(loop_plant())
    speed = guards()["approach_step_V"] * extension * RATE_Hz
    half = guards(approach_m_per_s=speed / 2)
    assert half["approach_step_V"] == pytest.approx(guards()["approach_step_V"] / 2)
    with pytest.raises(LabFileError, match="responds in time"):
        guards(approach_m_per_s=1.01 * speed)


def test_the_limits_of_a_stuck_sensor_follow_from_its_noise():
    """Johnson noise of 0.42 pA moves a reading by 0.3 pA steps, but not by 78 pA steps."""
    assert guards()["stuck_samples"] == 20
    assert guards()["stuck_current_A"] == -1.0
    eight_bits = structs.replace(LAB.acquisition, dac_bits=8, adc_bits=8)
    coarse = replace(LAB, acquisition=eight_bits)
    values = tip_guards(coarse, SPECIFICATION, RATE_Hz, loop_plant())
    assert values["stuck_samples"] == 200
    assert values["stuck_current_A"] == values["current_floor_A"]
