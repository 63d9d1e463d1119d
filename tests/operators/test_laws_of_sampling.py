"""The laws of exact sampling, and the two samplers of the house held against each other.

`numerics.zero_order_hold` and `operators.linear` were written apart, for the design and for the
simulation; neither may import the other.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.numerics import zero_order_hold
from piezoid.numerics.arrays import Array
from piezoid.operators import linear
from piezoid.operators.linear import (
    ContinuousSystem,
    butterworth,
    cascade,
    first_order,
    resonance,
)
from tests.operators.strategies import drives

RATE_Hz = 20e3
CLOSE = 1e-9


@st.composite
def chains(draw: st.DrawFn, delay: bool = True) -> ContinuousSystem:
    """A pole or a mode or both, from slow to beyond the sampling rate, perhaps late."""
    parts = []
    for kind in draw(st.sampled_from(["lag", "mode", "lag mode", "mode mode", "filter"])).split():
        frequency_Hz = 10.0 ** draw(st.floats(1.0, 4.5))
        if kind == "lag":
            parts.append(first_order(frequency_Hz))
        elif kind == "mode":
            parts.append(resonance(frequency_Hz, draw(st.floats(0.005, 2.0))))
        else:
            parts.append(butterworth(draw(st.integers(1, 5)), frequency_Hz))
    whole = cascade(*parts)
    late = draw(st.floats(0.0, 3.0) | st.sampled_from([0.0, 1.0, 2.0])) if delay else 0.0
    return ContinuousSystem(A=whole.A, B=whole.B, C=whole.C, D=whole.D, delay_s=late / RATE_Hz)


@given(chains())
def test_both_samplers_give_the_same_samples(system: ContinuousSystem) -> None:
    one = linear.sample(system, RATE_Hz).impulse_response(40)[:, 0, 0]
    other = zero_order_hold.sample(
        system.A, system.B[:, 0], system.C[0], 1 / RATE_Hz, system.delay_s
    )
    A, B, C = zero_order_hold.realised(other)
    two, state = np.zeros(40), B
    for k in range(1, 40):
        two[k], state = C @ state, A @ state
    np.testing.assert_allclose(one, two, atol=CLOSE)


@given(chains(), chains())
def test_the_response_of_a_chain_is_the_product_of_its_parts(
    first: ContinuousSystem, second: ContinuousSystem
) -> None:
    frequency_Hz = np.geomspace(1.0, 1e5, 7)
    both = cascade(first, second).response(frequency_Hz)[:, 0, 0]
    parts = first.response(frequency_Hz)[:, 0, 0] * second.response(frequency_Hz)[:, 0, 0]
    np.testing.assert_allclose(both, parts, rtol=1e-7, atol=1e-12)
    assert cascade(first, second).delay_s == first.delay_s + second.delay_s


@given(chains(), drives(most=150), drives(150, 150), st.integers(0, 150))
def test_running_is_linear_causal_and_may_be_cut_anywhere(
    system: ContinuousSystem, one: Array, two: Array, cut: int
) -> None:
    sampled = linear.sample(system, RATE_Hz)
    two = two[: len(one)]
    whole, end = sampled.run(one)
    np.testing.assert_allclose(
        sampled.run(2.0 * one - two)[0], 2.0 * whole - sampled.run(two)[0], atol=1e-7
    )
    first, state = sampled.run(one[:cut])
    second, after = sampled.run(one[cut:], state)
    np.testing.assert_allclose(np.concatenate([first, second]), whole, atol=1e-7)
    np.testing.assert_allclose(after, end, atol=1e-7)
    np.testing.assert_allclose(first, whole[:cut], atol=1e-7)
