"""Plants from physical quantities and from fractions."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.junction_task import vertical_task
from piezoid.design.plant import Plant, sampled_plant
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import response
from piezoid.operators.linear import DiscreteSystem, hold_matrices, resonance
from tests.design.junction_lab import LAB, NOMINAL, loop_plant
from tests.design.rig import RATE_Hz, lateral_chain

PERIOD_s = 1.0 / RATE_Hz


def mode(frequency_Hz: float, damping: float, delay_samples: float) -> Plant:
    system = replace(resonance(frequency_Hz, damping), delay_s=delay_samples * PERIOD_s)
    return sampled_plant("mode", system, RATE_Hz, output_unit="m")


def simulated_finely(u: Array, frequency_Hz: float, damping: float, delay: int) -> Array:
    """Simulate a mode in 20 substeps of each period; the delay is whole substeps."""
    system = resonance(frequency_Hz, damping)
    step, drive = hold_matrices(system.A, system.B[:, 0], PERIOD_s / 20)
    pieces = np.concatenate([np.zeros(delay), np.repeat(u, 20)])
    x, y = np.zeros(2), np.empty(len(u))
    for k in range(len(u) * 20):
        if k % 20 == 0:
            y[k // 20] = system.C[0] @ x
        x = step @ x + drive * pieces[k]
    return y


@pytest.mark.parametrize("delay_samples", [0.0, 0.25, 0.6, 1.0, 1.4, 3.2])
def test_any_delay_agrees_with_fine_simulation(delay_samples, rng):
    u = rng.normal(size=60)
    transition, drive, output = mode(900.0, 0.1, delay_samples).realised()
    x, y = np.zeros(len(transition)), np.empty(len(u))
    for k, value in enumerate(u):
        y[k] = output @ x
        x = transition @ x + drive * value
    expected = simulated_finely(u, 900.0, 0.1, round(20 * delay_samples))
    np.testing.assert_allclose(y, expected, atol=1e-11)


@pytest.mark.parametrize("delay_samples", [0.0, 0.4, 2.7])
def test_fraction_and_state_space_are_the_same_plant(delay_samples):
    plant = mode(630.0, 0.05, delay_samples)
    frequency_Hz = np.geomspace(1.0, 9900.0, 60)
    A, B, C = plant.realised()
    state_space = DiscreteSystem(
        A=A, B=B[:, None], C=C[None], D=np.zeros((1, 1)), interval_s=PERIOD_s
    )
    np.testing.assert_allclose(
        response(plant.B, plant.A, frequency_Hz, RATE_Hz),
        state_space.response(frequency_Hz)[:, 0, 0],
        rtol=1e-9,
    )
    assert len(plant.A) == 3
    assert (plant.B[: 1 + int(delay_samples)] == 0.0).all()


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
