"""The gap law, its logarithm and the barrier, against constants and textbook values."""

import math

import numpy as np
import pytest
from scipy import constants

from piezoid.operators.tunnelling import (
    DECAY_AT_ONE_EV_PER_M,
    barrier_of_decay,
    decay_of_barrier,
    log_current,
)

EXACT = 1e-14  # a few roundings
CODATA_EDITIONS = 2e-9  # the electron mass moved by 1.5e-9 between the 2014 and 2022 editions


@pytest.mark.parametrize(("barrier_eV", "per_nm"), [(1.0, 10.246), (4.0, 20.493), (5.0, 22.912)])
def test_the_decay_matches_the_tabulated_values(barrier_eV, per_nm):
    assert decay_of_barrier(barrier_eV) * 1e-9 == pytest.approx(per_nm, abs=1e-3)


def test_the_decay_follows_the_constants_and_its_inverse(rng):
    for barrier_eV in rng.uniform(0.01, 10.0, 50):
        assert barrier_of_decay(decay_of_barrier(barrier_eV)) == pytest.approx(
            barrier_eV, rel=EXACT
        )
    expected = 2.0 * math.sqrt(2.0 * constants.m_e * constants.e) / constants.hbar
    assert pytest.approx(expected, rel=CODATA_EDITIONS) == DECAY_AT_ONE_EV_PER_M


@pytest.mark.parametrize("polarity", [1.0, -1.0])
def test_the_log_current_undoes_the_exponential_at_either_polarity(polarity):
    gap_m = np.linspace(-0.1e-9, 0.1e-9, 21)
    current_A = polarity * 1e-9 * np.exp(-2e10 * gap_m)
    nepers = log_current(current_A, set_point_A=polarity * 1e-9, floor_A=1e-13)
    assert nepers == pytest.approx(-2e10 * gap_m, abs=1e-13)


def test_a_lost_tip_reads_as_the_floor():
    nepers = log_current(np.array([-1e-12, 0.0, 1e-16]), set_point_A=1e-9, floor_A=1e-13)
    assert nepers == pytest.approx(np.full(3, math.log(1e-4)), rel=EXACT)
