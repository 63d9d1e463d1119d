"""The sampled plant is exact in time and in frequency."""

import numpy as np
import pytest

from piezoid.design.plant import sampled_plant
from piezoid.identification.tunnelling.junction_plant import JunctionPlant
from piezoid.operators.linear import ContinuousSystem

RATE_Hz = 20000.0
EXACT = 1e-9  # closed form against a matrix exponential, in gains of hundreds


def _plant(delay_s: float, sensor_pole_Hz: float = 7000.0) -> JunctionPlant:
    return JunctionPlant(
        gain_nepers_per_V=369.0,
        sensor_pole_Hz=sensor_pole_Hz,
        delay_s=delay_s,
        amplifier_pole_Hz=4000.0,
        sampling_rate_Hz=RATE_Hz,
    )


@pytest.mark.parametrize("delay_s", [0.0, 12e-6, 50e-6, 95e-6, 100e-6])
@pytest.mark.parametrize("sensor_pole_Hz", [900.0, 4000.0, 30000.0])
def test_the_step_response_is_that_of_the_continuous_chain(delay_s, sensor_pole_Hz):
    plant = _plant(delay_s, sensor_pole_Hz)
    a, s = 2 * np.pi * 4000.0, 2 * np.pi * sensor_pole_Hz
    chain = ContinuousSystem(
        A=np.array([[-a, 0.0], [s, -s]]),
        B=np.array([[a * plant.gain_nepers_per_V], [0.0]]),
        C=np.array([[0.0, 1.0]]),
        D=np.zeros((1, 1)),
        delay_s=delay_s,
    )
    transition, drive, output = sampled_plant("", chain, RATE_Hz, output_unit="1").realised()
    state, expected = np.zeros(len(transition)), []
    for _ in range(40):
        expected.append(float(output @ state))
        state = transition @ state + drive
    assert plant.respond(np.ones(40)) == pytest.approx(np.array(expected), abs=EXACT)


def test_the_frequency_response_is_the_spectrum_of_the_response_to_an_impulse():
    plant = _plant(61e-6)
    impulse = np.zeros(400)  # after which the slower transient has decayed by 200 nepers
    impulse[0] = 1.0
    lines = np.array([1, 40, 100, 199])
    expected = np.fft.rfft(plant.respond(impulse))[lines]
    response = plant.frequency_response(lines * RATE_Hz / len(impulse))
    assert response == pytest.approx(expected, rel=1e-10)


def test_a_negative_delay_is_refused():
    with pytest.raises(ValueError, match="delay_s"):
        _plant(-1e-6)
