"""A tunnelling axis ships with its guards, or not at all."""

from dataclasses import replace

import pytest

from piezoid.design.from_junction import vertical_task
from piezoid.errors import LabFileError
from piezoid.export.tip_guards import tip_guards
from piezoid.identification.tunnelling.model import TunnellingModel
from piezoid.records.lab import Tunnelling
from tests.design.junction_lab import LAB, loop_plant
from tests.design.rig import RATE_Hz

ASKED = vertical_task(TunnellingModel(gap_law=None, loop_plant=loop_plant()), LAB).specification


def guards(**changed: float | None):
    declared = {
        name: getattr(LAB.tunnelling, name) for name in ("set_point_A", "floor_A", "ceiling_A")
    }
    return tip_guards(
        replace(LAB, tunnelling=Tunnelling(**{**declared, **changed})),
        ASKED,
        RATE_Hz,
        loop_plant(),
    )


def test_a_tip_that_nobody_says_otherwise_of_retracts_to_the_lowest_command() -> None:
    found = guards()
    assert found.retract_voltage_V == ASKED.voltage_min_V
    assert (found.retract_samples, found.bad_samples) == (200, 20)
    assert guards(retract_V=-3.0).retract_voltage_V == -3.0


def test_the_sign_of_the_bias_is_not_the_runtimes_business() -> None:
    assert guards(set_point_A=-1e-9).reference_A == 1e-9


@pytest.mark.parametrize("name", ["set_point_A", "floor_A", "ceiling_A"])
def test_a_missing_guard_is_refused_with_the_line_to_write(name: str) -> None:
    with pytest.raises(LabFileError, match=rf"`{name} = .*` under \[tunnelling\]"):
        guards(**{name: None})


@pytest.mark.parametrize(
    "changed",
    [{"floor_A": 2e-9}, {"ceiling_A": 5e-10}, {"retract_V": -11.0}, {"retract_V": 10.5}],
)
def test_guards_that_guard_nothing_are_refused(changed: dict[str, float]) -> None:
    with pytest.raises(LabFileError, match="export again"):
        guards(**changed)
