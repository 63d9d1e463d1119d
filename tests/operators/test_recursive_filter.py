"""Recursive filters against SciPy's, and against what their poles promise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from piezoid.operators.linear import recursive_filter

COEFFICIENT = st.floats(-2.0, 2.0)
FRACTIONS = st.tuples(
    st.lists(COEFFICIENT, min_size=1, max_size=5),
    st.lists(COEFFICIENT, max_size=4),
    st.sampled_from([1.0, -0.5, 3.0]),
)


@given(fraction=FRACTIONS, samples=st.integers(1, 40), seed=st.integers(0, 99))
def test_what_comes_out_is_what_scipy_makes(fraction, samples, seed) -> None:
    numerator, others, first = fraction
    signal = np.random.default_rng(seed).normal(size=samples)
    expected = lfilter(numerator, [first, *others], signal)
    found = recursive_filter(numerator, [first, *others], signal)
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9 * scale)


def test_a_signal_that_is_not_contiguous_is_filtered_as_its_copy() -> None:
    signal = np.arange(20.0)[::2]
    made = recursive_filter([0.3], [1.0, -0.7], signal)
    np.testing.assert_array_equal(made, recursive_filter([0.3], [1.0, -0.7], signal.copy()))


def test_a_denominator_that_does_not_determine_the_output_is_refused() -> None:
    with pytest.raises(ValueError, match="newest output is not determined"):
        recursive_filter([1.0], [0.0, 1.0], np.ones(3))
