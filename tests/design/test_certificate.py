"""Certificates: bounds of the error in closed loop."""

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.certificate import certify, impulse_response
from piezoid.design.feedforward import ReferencePath, fit_reference_path
from piezoid.design.hysteresis_bounds import affine_bounds
from piezoid.design.observer import linear_controller
from piezoid.design.sensitivity import closed_loop_polynomial
from piezoid.errors import UnstableLoopError
from piezoid.numerics.arrays import Array
from tests.design.hysteretic import REACH_V, THRESHOLD_V, hysteresis, loop
from tests.design.rig import LATERAL_m_per_V, RATE_Hz, lateral_chain

BOUNDS = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
PLANT, OBSERVER = loop(BOUNDS)
CONTROLLER = linear_controller(OBSERVER)


def run_around_hysteresis(
    path: ReferencePath, reference_m: Array, step_V: float
) -> tuple[Array, Array]:
    """Simulate the affine form with hysteresis and dynamics of unit gain; return y and u."""
    observer = OBSERVER
    unit = plant_from_chain(lateral_chain(1.0))
    A, B, C = unit.realised()
    z = np.zeros(len(THRESHOLD_V))
    weight = hysteresis().plays.weight
    filtered = np.convolve(reference_m, path.filter)[: len(reference_m)]
    x, x_, d_ = np.zeros(len(A)), np.zeros(len(observer.A)), 0.0
    y, u = np.empty(len(reference_m)), np.empty(len(reference_m))
    for k, r in enumerate(filtered):
        y[k] = C @ x
        nu = y[k] - observer.C @ x_
        xh, d = x_ + observer.state_gain * nu, d_ + observer.disturbance_gain[0] * nu
        u[k] = observer.reference_gain * r - observer.feedback_gain @ xh - d
        if step_V:
            u[k] = step_V * np.round(u[k] / step_V)
        z = np.maximum(u[k] - THRESHOLD_V, np.minimum(u[k] + THRESHOLD_V, z))
        x = A @ x + B * (weight @ z)
        x_, d_ = observer.A @ xh + observer.B * (u[k] + d), d
    return y, u


def path_and_certificate(slew_m_per_s, step_V=0.0, plants=(PLANT,)):
    c = CONTROLLER
    path = fit_reference_path([PLANT], c.R, c.S, c.T, band_Hz=100.0)
    certificate = certify(
        *(plants, c.R, c.S, c.T),
        path=path,
        bounds=BOUNDS,
        reference_slew_m_per_s=slew_m_per_s,
        voltage_step_V=step_V,
        sensor_noise_rms_m=1e-9,
    )
    return path, certificate


def test_the_small_gain_is_the_sector_times_the_peak_of_the_loop():
    _, certificate = path_and_certificate(1e-4)
    z = np.exp(1j * np.linspace(1e-4, np.pi, 100_001))
    c = CONTROLLER
    p = [np.polyval(x[::-1], 1 / z) for x in (PLANT.B, c.R, PLANT.A, c.S)]
    peak = np.abs(p[0] * p[1] / (p[2] * p[3] + p[0] * p[1])).max()
    assert certificate.loop_peak == pytest.approx(peak, rel=1e-3)
    assert certificate.small_gain == pytest.approx(BOUNDS.increment_gain * peak, rel=1e-3)
    assert certificate.is_guaranteed


@pytest.mark.parametrize("frequency_Hz", [2.0, 10.0, 40.0])
@pytest.mark.parametrize("step_V", [0.0, 5e-3])
def test_the_guaranteed_error_is_never_exceeded_in_closed_loop(frequency_Hz, step_V):
    amplitude_m = 0.6 * REACH_V * LATERAL_m_per_V
    t = np.arange(int(2.5 / frequency_Hz * RATE_Hz)) / RATE_Hz
    reference = amplitude_m * np.sin(2 * np.pi * frequency_Hz * t)
    slew = 2 * np.pi * frequency_Hz * amplitude_m
    path, certificate = path_and_certificate(slew, step_V)
    y, u = run_around_hysteresis(path, reference, step_V)
    assert np.abs(u).max() <= REACH_V  # a condition of the certificate
    p = path.preview_samples
    error = np.abs(reference[: len(reference) - p] - y[p:]).max()
    assert error <= certificate.guaranteed_error_m
    assert error >= 0.02 * certificate.guaranteed_error_m  # the bound is of practical use
    assert certificate.guaranteed_error_m == pytest.approx(
        certificate.hysteresis_error_m
        + certificate.reference_error_m
        + certificate.converter_error_m
    )


def test_a_certificate_also_bounds_the_error_of_slower_references():
    fast_m_per_s = 2e-3
    _, fast = path_and_certificate(fast_m_per_s, 5e-3)
    for slow_m_per_s in (1e-7, 2e-5, 3e-4, fast_m_per_s):
        _, slow = path_and_certificate(slow_m_per_s, 5e-3)
        assert fast.guaranteed_at(slow_m_per_s) == pytest.approx(slow.guaranteed_error_m)
    assert fast.guaranteed_at(2e-5) < 0.1 * fast.guaranteed_error_m
    assert np.isinf(fast.guaranteed_at(1.01 * fast_m_per_s))


def test_the_worst_rounding_errors_attain_the_bound_of_the_converter():
    _, certificate = path_and_certificate(1e-4, step_V=2e-3)
    c = CONTROLLER
    response = impulse_response(np.convolve(PLANT.B, c.S), closed_loop_polynomial(PLANT, c.R, c.S))
    half_steps_V = 1e-3 * np.sign(response[::-1])
    assert half_steps_V @ response[::-1] == pytest.approx(certificate.converter_error_m, rel=1e-9)


def test_the_noise_is_stated_apart_with_three_standard_deviations():
    _, certificate = path_and_certificate(1e-4)
    # White noise is a sum of independent impulses, whose squares add.
    impulse, c = 1e-9 * np.eye(3000)[0], CONTROLLER
    y = lfilter(np.convolve(PLANT.B, c.R), closed_loop_polynomial(PLANT, c.R, c.S), impulse)
    assert certificate.noise_error_m == pytest.approx(3.0 * np.linalg.norm(y), rel=1e-6)


def test_an_unstable_member_has_no_certificate():
    unstable = plant_from_chain(lateral_chain(8.0 * BOUNDS.gain_m_per_V))
    with pytest.raises(UnstableLoopError, match="has a pole of magnitude"):
        path_and_certificate(1e-4, plants=(PLANT, unstable))
