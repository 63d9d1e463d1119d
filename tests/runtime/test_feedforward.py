"""A feedforward table is added to the output of the controller, within its limits."""

import numpy as np
import pytest

from piezoid.runtime.controller import Status
from tests.runtime.runtime_parameters import started
from tests.verification.rig import lateral_parameters


def controllers(precision="double", method="mpi_dob"):
    values = lateral_parameters().for_method(method).values
    return [started(values, precision=precision) for _ in range(2)]


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("method", ["none", "mpi", "dob", "mpi_dob"])
def test_a_table_of_zero_changes_no_bit(method, precision):
    feedback, with_table = controllers(precision, method)
    rng = np.random.default_rng(0)
    references, readings = 1e-5 * rng.standard_normal((2, 500))
    readings[100:110], references[300] = np.nan, np.inf
    for reference, reading in zip(references.tolist(), readings.tolist(), strict=True):
        voltage_V, with_table_V = (
            feedback.step(reference, reading),
            with_table.step(reference, reading, 0.0),
        )
        assert (voltage_V, np.signbit(voltage_V)) == (with_table_V, np.signbit(with_table_V))
        assert feedback.status == with_table.status


def test_a_table_is_added_within_the_limits():
    feedback, with_table = controllers()
    assert with_table.step(0.0, 0.0, 0.5) == pytest.approx(feedback.step(0.0, 0.0) + 0.5, abs=2e-4)
    for value_V in (1e9, -1e300):
        assert abs(with_table.step(0.0, 0.0, value_V)) <= 10.0
        assert Status.VOLTAGE_LIMITED in with_table.status


@pytest.mark.parametrize("bad_V", [np.nan, np.inf, -np.inf])
def test_an_invalid_table_value_is_ignored_and_reported(bad_V):
    feedback, with_table = controllers()
    assert with_table.step(1e-6, 0.0, bad_V) == feedback.step(1e-6, 0.0)
    assert Status.BAD_REFERENCE in with_table.status
