"""Laws of exact sampling, and agreement of the two independent samplers.

`sampled_plant` serves the design and `operators.linear.sample` the simulation; neither calls the
other.
"""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from piezoid.design.plant import sampled_plant
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
TOLERANCE = 1e-9


@st.composite
def chains(draw: st.DrawFn, delay: bool = True) -> ContinuousSystem:
    """Draw poles and modes from slow to beyond the sampling rate, some with a delay."""
    parts = []
    for kind in draw(st.sampled_from(["lag", "mode", "lag mode", "mode mode", "filter"])).split():
        frequency_Hz = 10.0 ** draw(st.floats(1.0, 4.5))
        if kind == "lag":
            parts.append(first_order(frequency_Hz))
        elif kind == "mode":
            parts.append(resonance(frequency_Hz, draw(st.floats(0.005, 2.0))))
        else:
            parts.append(butterworth(draw(st.integers(1, 5)), frequency_Hz))
    chain = cascade(*parts)
    delay_samples = draw(st.floats(0.0, 3.0) | st.sampled_from([0.0, 1.0, 2.0])) if delay else 0.0
    return ContinuousSystem(
        A=chain.A, B=chain.B, C=chain.C, D=chain.D, delay_s=delay_samples / RATE_Hz
    )


@given(chains())
def test_both_samplers_give_the_same_samples(system):
    linear_response = linear.sample(system, RATE_Hz).impulse_response(40)[:, 0, 0]
    A, B, C = sampled_plant("chain", system, RATE_Hz, output_unit="m").realised()
    hold_response, state = np.zeros(40), B
    for k in range(1, 40):
        hold_response[k], state = C @ state, A @ state
    np.testing.assert_allclose(linear_response, hold_response, atol=TOLERANCE)


@given(chains(), chains())
def test_the_response_of_a_chain_is_the_product_of_its_parts(first, second):
    frequency_Hz = np.geomspace(1.0, 1e5, 7)
    response = cascade(first, second).response(frequency_Hz)[:, 0, 0]
    product = first.response(frequency_Hz)[:, 0, 0] * second.response(frequency_Hz)[:, 0, 0]
    np.testing.assert_allclose(response, product, rtol=1e-7, atol=1e-12)
    assert cascade(first, second).delay_s == first.delay_s + second.delay_s


@given(chains(), drives(max_samples=150), drives(150, 150), st.integers(0, 150))
def test_running_is_linear_causal_and_may_be_cut_anywhere(system, drive, second_drive, cut):
    sampled = linear.sample(system, RATE_Hz)
    second_drive = second_drive[: len(drive)]
    output, end_state = sampled.run(drive)
    np.testing.assert_allclose(
        sampled.run(2.0 * drive - second_drive)[0],
        2.0 * output - sampled.run(second_drive)[0],
        atol=1e-7,
    )
    first_part, state = sampled.run(drive[:cut])
    second_part, final_state = sampled.run(drive[cut:], state)
    np.testing.assert_allclose(np.concatenate([first_part, second_part]), output, atol=1e-7)
    np.testing.assert_allclose(final_state, end_state, atol=1e-7)
    np.testing.assert_allclose(first_part, output[:cut], atol=1e-7)
