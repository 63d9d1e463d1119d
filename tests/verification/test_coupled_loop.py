"""Two coupled axes in closed loop at the same time, with and without the decoupling matrix."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.export.parameter_file import Decoupled
from piezoid.verification.verification import Verification, verification_from_json
from piezoid.verification.verify import verify
from tests.coupled_axes import coupled_axes
from tests.verification.rig import PLANTS, stage

IDENTITY = Decoupled(axes=("x", "y"), matrix=np.eye(2))
NAME = "motion of an axis while another one moves"


def run(decoupled: Decoupled | None, *axes: str) -> Verification:
    file = replace(stage(*axes), decoupled=decoupled)
    plants = [plant for plant in PLANTS if plant.axis in axes]
    return verify(file, plants, scenarios=(), trials=(), coupled=coupled_axes())


@pytest.fixture(scope="module")
def verification() -> Verification:
    return run(Decoupled(axes=("x", "y"), matrix=coupled_axes().decoupling), "x", "y")


def test_the_decoupling_matrix_reduces_coupled_motion_fivefold(verification):
    pairs = {(row.moved, row.answers): row for row in verification.coupling}
    assert set(pairs) == {("x", "y"), ("y", "x")}
    for row in pairs.values():
        assert row.without_percent is not None
        assert row.percent < 0.2 * row.without_percent
    (verdict,) = (verdict for verdict in verification.verdicts if verdict.name == NAME)
    assert verdict.passed
    assert verdict.value == max(row.percent for row in verification.coupling)
    without = {row.moved: row.without_percent for row in verification.coupling}
    assert without["y"] is not None
    assert 0.1 < without["y"] < 12.0
    assert verification_from_json(verification.to_json()).coupling == verification.coupling


def test_an_identity_changes_nothing_and_unshipped_axes_are_not_run():
    for row in run(IDENTITY, "x", "y").coupling:
        assert row.percent == row.without_percent
    assert run(IDENTITY, "x").coupling == ()
    assert run(None, "x", "y").coupling == ()
