"""The sampled plant is exact in its three forms, compared with the matrix exponential."""

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
    split = 1e-3 if sensor_pole_Hz == 4000.0 else EXACT  # a double pole is split by 1e-6
    assert plant.respond(np.ones(40)) == pytest.approx(np.array(expected), abs=split)


def test_the_frequency_response_is_that_of_the_polynomials():
    plant = _plant(61e-6)
    numerator, denominator = plant.polynomials()
    frequency_Hz = np.array([1.0, 100.0, 3000.0, 9900.0])
    inverse_z = np.exp(-2j * np.pi * frequency_Hz / RATE_Hz)
    expected = np.polyval(numerator[::-1], inverse_z) / np.polyval(denominator[::-1], inverse_z)
    assert plant.frequency_response(frequency_Hz) == pytest.approx(expected, rel=1e-10)


def test_a_negative_delay_is_refused():
    with pytest.raises(ValueError, match="delay_s"):
        _plant(-1e-6)
