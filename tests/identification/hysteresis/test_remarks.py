"""A fit without each block of its data, from the normal equations of the blocks."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.hysteresis.estimate import remarks_on
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.hysteresis.uncertainty import leave_blocks_out
from piezoid.identification.quality import OTHER_RECORDINGS
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.test_order import SHAPE, pieces

DECLARED = Rig(amplifier_bandwidth_Hz=4000.0)


def blocks_of(count: int) -> tuple[Array, Array]:
    """J'J and J'e of every block; of the first number the whole fit is the least error."""
    rng = np.random.default_rng(3)
    rows, error = rng.normal(size=(count, 20, 3)), rng.normal(size=(count, 20))
    error -= (rows[..., 0] * error).sum() / (rows[..., 0] ** 2).sum() * rows[..., 0]
    return np.einsum("bri,brj->bij", rows, rows), np.einsum("bri,br->bi", rows, error)


def test_free_numbers_become_what_the_other_blocks_say_and_those_on_a_bound_stay() -> None:
    """One number that is free, one held from below, one held from above."""
    bounds = np.array([-10.0, 0.0, 0.0]), np.array([10.0, 2.0, 1.0])
    normals, gradients = blocks_of(12)
    found = leave_blocks_out(np.array([0.5, 0.0, 1.0]), bounds, normals, gradients)
    assert found.is_free.tolist() == [True, False, False]
    assert (found.replicates[:, 1:] == [0.0, 1.0]).all()
    # Products of the others add up to what the block's own take away.
    others = normals[:, 0, 0].sum() - normals[:, 0, 0]
    np.testing.assert_allclose(found.replicates[:, 0], 0.5 + gradients[:, 0] / others)


@pytest.mark.parametrize(("iterations", "gap"), [(30, 0.0), (1, 1.0)])
def test_a_start_that_was_not_the_optimum_has_a_remark(iterations: int, gap: float) -> None:
    settings = Settings(longest_lag_s=0.02, follow_zero=False)
    fitted = search(pieces(1), SHAPE, replace(settings, iterations=iterations))
    assert fitted.converged is (iterations == 30)
    remarks = remarks_on(replace(fitted, kkt_gap=gap), OTHER_RECORDINGS, Rig())
    assert any("optimal only to" in remark for remark in remarks) is (gap > 0.0)


def test_a_lag_on_zero_names_the_declared_poles_that_may_be_too_slow() -> None:
    shape = replace(SHAPE, lag="delay")
    fitted = search(pieces(1), shape, Settings(longest_lag_s=0.02, iterations=1))
    theta = fitted.theta.copy()
    theta[fitted.task.coordinates.slices["lag"]] = 0.0
    ahead = replace(fitted, theta=theta)
    said = [" ".join(remarks_on(ahead, OTHER_RECORDINGS, rig)) for rig in (Rig(), DECLARED)]
    assert "may lead the drive" in said[0]
    assert "the declared poles (4.00 kHz) delay at least as much" in said[1]
