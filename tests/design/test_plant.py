"""Plants from physical quantities and from fractions."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.junction_task import vertical_task
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.numerics.polynomial import response
from tests.design.junction_lab import LAB, NOMINAL, loop_plant
from tests.design.rig import RATE_Hz, lateral_chain, random_chain


def test_the_gain_at_rest_is_the_chains(rng):
    for _ in range(20):
        chain = random_chain(rng)
        plant = plant_from_chain(chain)
        assert plant.gain == pytest.approx(chain.gain, rel=1e-9)
        assert np.abs(plant.poles).max() < 1.0


@pytest.mark.parametrize(("sensor_Hz", "order"), [(110e3, 2), (120e3, 1), (np.inf, 1)])
def test_a_pole_below_the_resolution_of_float64_has_no_state(sensor_Hz, order):
    """A pole at 120 kHz sampled at 20 kHz is exp(-37.7)."""
    junction = replace(NOMINAL, sensor_pole_Hz=sensor_Hz)
    loop = replace(loop_plant(), plant=junction, family=(junction,))
    tip = TunnellingModel(gap_law=None, loop_plant=loop)
    assert len(vertical_task(tip, LAB)[0].nominal.state_matrix) == order


def test_a_delay_replaced_by_a_pole_is_the_same_plant_at_low_frequency():
    exact = plant_from_chain(replace(lateral_chain(), delay_s=30.5 / RATE_Hz))
    short = exact.with_delay_pole(25)
    assert len(short.realised()[0]) == len(exact.realised()[0]) - 24
    assert short.delay_samples == exact.delay_samples - 25
    assert short.gain == pytest.approx(exact.gain, rel=1e-9)
    frequency_Hz = np.array([1.0, 30.0, 300.0])
    a, b = (response(p.B, p.A, frequency_Hz, RATE_Hz) for p in (exact, short))
    phase = 2.0 * np.pi * frequency_Hz * 25 / RATE_Hz  # of the replaced samples of delay
    assert (np.abs(b / a - 1.0)[:2] < 0.6 * phase[:2] ** 2).all()
    A, B, C = short.realised()
    z = np.exp(2j * np.pi * frequency_Hz[2] / RATE_Hz)
    response_of_states = C @ np.linalg.solve(z * np.eye(len(A)) - A, B)
    assert response_of_states == pytest.approx(b[2])
