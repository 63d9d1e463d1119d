"""What every play sum and every modified model must obey, whatever its numbers."""

from contextlib import nullcontext

import numpy as np
import pytest

from piezoid.errors import NotInvertibleError
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from tests.operators.draws import random_walk


def play_by_definition(u: Array, r: float, z0: float) -> Array:
    z = np.empty_like(u)
    for k, value in enumerate(u):
        z0 = max(value - r, min(value + r, z0))
        z[k] = z0
    return z


def test_kernel_columns_equal_the_definition_for_any_bank_size(rng: np.random.Generator) -> None:
    u = random_walk(rng, 500)
    for plays in (1, 7, 31, 32, 33, 70):
        r, z0 = np.sort(rng.uniform(0, 3, plays)), rng.normal(0, 1, plays)
        columns, after = play_columns(u, r, z0)
        for i in range(plays):
            np.testing.assert_array_equal(columns[:, i], play_by_definition(u, r[i], z0[i]))
        np.testing.assert_array_equal(after, columns[-1])


def test_a_map_that_is_flat_anywhere_has_no_inverse() -> None:
    for last, invertible in ((-0.999, True), (-1.0, False), (-1.001, False)):
        zones = DeadZones(threshold=np.array([0.0, 1.0]), weight=np.array([1.0, last]))
        with nullcontext() if invertible else pytest.raises(NotInvertibleError):
            zones.inverse()
        assert np.ptp(zones.run(np.array([1.0, 2.0]))) == pytest.approx(abs(1.0 + last))


def test_weights_without_an_inverse_are_refused_with_their_number() -> None:
    plays = PrandtlIshlinskii(threshold=np.array([0.0, 1]), weight=np.array([0.5, -0.7]))
    with pytest.raises(NotInvertibleError, match=r"W_1 is -0.2"):
        plays.inverse()
    zones = DeadZones(threshold=np.array([0.0, 1]), weight=np.array([1.0, -1.5]))
    with pytest.raises(NotInvertibleError, match=r"-0.5"):
        zones.inverse()
