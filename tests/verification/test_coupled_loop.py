"""Two coupled axes under control at the same time: the matrix takes their coupling away."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.export.parameter_file import Decoupled
from piezoid.verification.verification import Verification, verification_from_json
from piezoid.verification.verify import verify
from tests.coupled_axes import coupled_axes
from tests.verification.rig import PLANTS, stage

PLAIN = Decoupled(axes=("x", "y"), matrix=np.eye(2))
NAME = "motion of an axis while another one moves"


def run(decoupled: Decoupled | None, *axes: str) -> Verification:
    file = replace(stage(*axes), decoupled=decoupled)
    plants = [plant for plant in PLANTS if plant.axis in axes]
    return verify(file, plants, scenarios=(), trials=(), coupled=coupled_axes())


@pytest.fixture(scope="module")
def found() -> Verification:
    return run(Decoupled(axes=("x", "y"), matrix=coupled_axes().decoupling), "x", "y")


def test_behind_the_matrix_axes_hardly_move_each_other(found: Verification) -> None:
    pairs = {(row.moved, row.answers): row for row in found.coupling}
    assert set(pairs) == {("x", "y"), ("y", "x")}
    for row in pairs.values():
        assert row.without_percent is not None
        assert row.percent < 0.2 * row.without_percent
    (verdict,) = (one for one in found.verdicts if one.name == NAME)
    assert verdict.passed
    assert verdict.value == max(row.percent for row in found.coupling)


def test_a_matrix_that_does_nothing_changes_nothing() -> None:
    for row in run(PLAIN, "x", "y").coupling:
        assert row.percent == row.without_percent


def test_feedback_rejects_a_part_of_the_coupling_by_itself(found: Verification) -> None:
    without = {row.moved: row.without_percent for row in found.coupling}
    assert without["y"] is not None
    assert 0.1 < without["y"] < 12.0


def test_axes_that_do_not_all_ship_are_not_run_together() -> None:
    assert run(PLAIN, "x").coupling == ()
    assert run(None, "x", "y").coupling == ()


def test_the_rows_come_back_from_their_file(found: Verification) -> None:
    assert verification_from_json(found.to_json()).coupling == found.coupling
