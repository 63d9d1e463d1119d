"""A table's value on top of the controller: nothing without it, limited with it."""

import numpy as np
import pytest

from piezoid.runtime.controller import Controller, Status
from tests.verification.rig import lateral_parameters


def controllers(precision="double", method="mpi_dob"):
    values = lateral_parameters().for_method(method).values
    made = [Controller(values, precision=precision) for _ in range(2)]
    for one in made:
        one.start(0.0, 0.0)
    return made


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_without_a_table_the_step_is_the_old_one_bit_for_bit(method, precision):
    plain, fed = controllers(precision, method)
    rng = np.random.default_rng(0)
    references, readings = 1e-5 * rng.standard_normal((2, 500))
    readings[100:110], references[300] = np.nan, np.inf
    for reference, reading in zip(references.tolist(), readings.tolist(), strict=True):
        one, other = plain.step(reference, reading), fed.step(reference, reading, 0.0)
        assert (one, np.signbit(one)) == (other, np.signbit(other))
        assert plain.status == fed.status


def test_a_table_goes_on_top_and_never_past_the_limits():
    plain, fed = controllers()
    assert fed.step(0.0, 0.0, 0.5) == pytest.approx(plain.step(0.0, 0.0) + 0.5, abs=2e-4)
    for far_V in (1e9, -1e300):
        assert abs(fed.step(0.0, 0.0, far_V)) <= 10.0
        assert Status.VOLTAGE_LIMITED in fed.status


@pytest.mark.parametrize("bad_V", [np.nan, np.inf, -np.inf])
def test_a_value_that_is_no_number_counts_as_none_and_is_told(bad_V):
    plain, fed = controllers()
    assert fed.step(1e-6, 0.0, bad_V) == plain.step(1e-6, 0.0)
    assert Status.BAD_REFERENCE in fed.status
