"""What parameters must agree in may differ by what rounding them can do, and by no more.

``near`` in piezoid_runtime.c: sixty-four roundings of all that the two sides are summed from.
"""

import numpy as np
import pytest

from tests.runtime.test_schema import LATERAL, refused

ROUNDINGS = 64
EPSILON = {"double": 2.0**-52, "float": 2.0**-23}
# Every number is exact in both precisions, and none is small beside the others.
SECTION = np.array([2.0, -1.5, 0.75, -0.5, 0.75])
A, REST = np.array([[0.5, -0.125], [0.25, 0.5]]), np.array([1.0, -2.0])
OBSERVER = {
    **LATERAL,
    "gain_m_per_V": 1.0,
    "observer_order": 2,
    "observer_A": A,
    "observer_B": REST - A @ REST,
    "observer_C": np.array([2.0, 0.5]),
    "observer_L": np.zeros(2),
    "observer_rest": REST,
    "feedback_K_V": np.array([0.5, 0.125]),
    "feedback_N_V_per_m": np.array(1.25),
}
# Which number is moved, what its check sums, and the name the runtime answers with.
AGREEMENTS = [
    ("observer_B", 0, np.r_[REST[0], OBSERVER["observer_B"][0], A[0] * REST], "observer_rest"),
    ("observer_B", 1, np.r_[REST[1], OBSERVER["observer_B"][1], A[1] * REST], "observer_rest"),
    ("observer_C", 0, np.r_[1.0, OBSERVER["observer_C"] * REST], "observer_C"),
    ("feedback_N_V_per_m", 0, np.r_[1.0, OBSERVER["feedback_K_V"] * REST], "feedback_N_V_per_m"),
    ("reference_section", 0, np.r_[1.0, SECTION], "reference_section"),
    ("command_section", 0, np.r_[1.0, SECTION], "command_section"),
]


def sections():
    """Unit gain at rest on the reference and on the command."""
    unit = {f"{place}_section": SECTION[None, :].copy() for place in ("reference", "command")}
    return {**unit, "reference_section_count": 1, "command_section_count": 1}


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("share", [-1.1, -0.9, 0.0, 0.9, 1.1])
@pytest.mark.parametrize(("name", "place", "summed", "blamed"), AGREEMENTS)
def test_numbers_agree_up_to_the_rounding_of_their_terms(
    name, place, summed, blamed, share, precision
):
    given = {**OBSERVER, **sections()}
    moved = np.array(given[name], dtype=float)
    moved.ravel()[place] += share * ROUNDINGS * EPSILON[precision] * np.abs(summed).sum()
    answer = None if abs(share) < 1.0 else blamed
    assert refused({**given, name: moved}, precision) == answer


@pytest.mark.parametrize("precision", ["double", "float"])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize(("share", "answer"), [(0.9, None), (1.1, "play_memory_V")])
def test_plays_lie_apart_by_their_thresholds_up_to_rounding(share, answer, sign, precision):
    """Between the first two: thresholds 0 and 1 V, memory 0.75 and -0.25 V and a little more."""
    further = share * ROUNDINGS * EPSILON[precision] * (1.0 + 0.75 + 0.25)
    memory_V = sign * np.array([0.75, -0.25 - further, 0.0, 0.0])
    assert refused({**LATERAL, "play_memory_V": memory_V}, precision) == answer
