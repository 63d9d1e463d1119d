"""Guarantees: norms by hand, bounds never exceeded in closed loop around real hysteresis."""

import numpy as np
import pytest

from piezoid.design.certificate import (
    Operation,
    certify,
    impulse_response,
    peak_gain,
    without_difference,
)
from piezoid.design.chain import plant_from_chain
from piezoid.design.feedforward import ReferencePath, filter_sections, fit_reference_path
from piezoid.design.hysteresis_bounds import HysteresisBounds, affine_bounds, inverse_bounds
from piezoid.design.lateral import with_sector
from piezoid.design.observer import DisturbanceObserver, place_observer
from piezoid.design.observer_loop import linear_controller
from piezoid.design.plant import Plant, PlantFamily
from piezoid.errors import UnstableLoopError
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from tests.design.rig import (
    LATERAL_m_per_V,
    RATE_Hz,
    lateral_chain,
    printed_observer_poles,
)

THRESHOLD_V = np.array([0.0, 0.5, 1.0, 2.0, 3.5])
SLOPES = np.array([0.72, 0.84, 0.92, 0.98, 1.02])
REACH_V = 3.0
ATTAINED = 1.0 + 1e-9  # the bounds are met exactly by some inputs


def hysteresis(
    scale: float = 1.0, zones: DeadZones = LINEAR, envelope: DeadZones = LINEAR
) -> ModifiedPrandtlIshlinskii:
    weight = np.diff(SLOPES, prepend=0.0) * LATERAL_m_per_V
    weight[1:] *= scale
    plays = PrandtlIshlinskii(threshold=THRESHOLD_V, weight=weight)
    return ModifiedPrandtlIshlinskii(plays=plays, dead_zones=zones, envelope=envelope)


def bent(by: float = 0.0) -> DeadZones:
    return DeadZones(
        threshold=np.array([-1.0, 0.0, 1.5]), weight=np.array([-0.08, 1.05 + by, 0.06])
    )


def curved() -> DeadZones:
    return DeadZones(threshold=np.array([-4e-6, 0.0, 5e-6]), weight=np.array([0.05, 1.0, -0.06]))


def loop(bounds: HysteresisBounds) -> tuple[Plant, DisturbanceObserver]:
    plant = plant_from_chain(lateral_chain(bounds.gain_m_per_V))
    feedback, observer = printed_observer_poles()
    return plant, place_observer(plant, feedback_poles=feedback, observer_poles=observer)


def run_around_hysteresis(
    o: DisturbanceObserver, path: ReferencePath, reference_m: Array, step_V: float
) -> tuple[Array, Array]:
    """Step the affine form around hysteresis, dynamics of unit gain behind it; return y and u."""
    unit = plant_from_chain(lateral_chain(1.0))
    A, B, C = unit.realised()
    z = np.zeros(len(THRESHOLD_V))
    weight = hysteresis().plays.weight
    filtered = np.convolve(reference_m, path.filter)[: len(reference_m)]
    x, x_, d_ = np.zeros(len(A)), np.zeros(len(o.A)), 0.0
    y, u = np.empty(len(reference_m)), np.empty(len(reference_m))
    for k, r in enumerate(filtered):
        y[k] = C @ x
        nu = y[k] - o.C @ x_
        xh, d = x_ + o.state_gain * nu, d_ + o.disturbance_gain[0] * nu
        u[k] = o.reference_gain * r - o.feedback_gain @ xh - d
        if step_V:
            u[k] = step_V * np.round(u[k] / step_V)
        z = np.maximum(u[k] - THRESHOLD_V, np.minimum(u[k] + THRESHOLD_V, z))
        x = A @ x + B * (weight @ z)
        x_, d_ = o.A @ xh + o.B * (u[k] + d), d
    return y, u


def certificate_of(plant, o, bounds, slew_m_per_s, step_V=0.0):
    c = linear_controller(o)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=100.0)
    operation = Operation(
        reference_slew_m_per_s=slew_m_per_s, voltage_step_V=step_V, sensor_noise_rms_m=1e-9
    )
    return path, certify([plant], c.R, c.S, c.T, path=path, bounds=bounds, operation=operation)


def test_the_norm_of_a_lag_is_its_geometric_sum():
    assert peak_gain([0.0, 0.3], [1.0, -0.9]) == pytest.approx(3.0, rel=1e-10)
    assert peak_gain([1.0], [1.0, 0.5]) == pytest.approx(2.0, rel=1e-10)
    assert impulse_response([1.0, 2.0], [1.0])[:3] == pytest.approx([1.0, 2.0, 0.0])


def test_dividing_by_a_difference_undoes_multiplying_by_it(rng):
    p = rng.normal(size=5)
    np.testing.assert_allclose(without_difference(np.convolve(p, [1.0, -1.0])), p, atol=1e-14)


def test_the_affine_bound_is_never_exceeded_and_nearly_attained(rng):
    for zones, envelope in ((LINEAR, LINEAR), (curved(), LINEAR), (LINEAR, bent())):
        model = hysteresis(zones=zones, envelope=envelope)
        bounds = affine_bounds(model, REACH_V, remainder_m=0.0)
        worst, least, most = 0.0, np.inf, 0.0
        for _ in range(60):
            u = np.cumsum(rng.normal(size=400))
            u *= REACH_V / np.abs(u).max() * rng.uniform(0.2, 1.0)
            y, _ = model.run(u, model.virgin_memory())
            worst = max(worst, np.abs(y - bounds.gain_m_per_V * u).max())
            slope = np.diff(y) / np.diff(u) / bounds.gain_m_per_V
            least, most = min(least, slope.min()), max(most, slope.max())
        assert 0.5 * bounds.error_m < worst <= bounds.error_m * ATTAINED
        assert bounds.slope_min - 1e-9 <= least
        assert most <= bounds.slope_max + 1e-9
        assert bounds.slope_min + bounds.slope_max == pytest.approx(2.0)


def one_play(envelope: DeadZones = LINEAR) -> ModifiedPrandtlIshlinskii:
    plays = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([LATERAL_m_per_V]))
    return ModifiedPrandtlIshlinskii(plays=plays, dead_zones=LINEAR, envelope=envelope)


KINKED = DeadZones(threshold=np.array([-3e-6, 0.0, 3e-6]), weight=np.array([0.4, 1.0, 0.4]))
WRONG = (-0.1, -0.05, 0.05, 0.1)


@pytest.mark.parametrize(
    ("model", "truths"),
    [
        pytest.param(
            hysteresis(zones=curved(), envelope=bent()),
            [hysteresis(1.0 + a, curved(), bent(0.3 * a)) for a in WRONG],
            id="everything is a little wrong",
        ),
        pytest.param(one_play(bent()), [one_play(bent(a)) for a in WRONG], id="envelope alone"),
        pytest.param(
            hysteresis(zones=KINKED),
            [hysteresis(1.0 + 4.0 * a, KINKED) for a in WRONG],
            id="the truth is past a kink, the model is not yet",
        ),
    ],
)
def test_the_inverse_of_a_model_leaves_no_more_than_its_bounds(model, truths, rng):
    bounds = inverse_bounds(
        model, truths, REACH_V, gain_m_per_V=LATERAL_m_per_V, remainder_m=0.0, confidence=1.0
    )
    least, most, worst = np.inf, 0.0, 0.0
    for truth in truths:
        for _ in range(30):
            u = np.cumsum(rng.normal(size=400))
            u *= REACH_V / np.abs(u).max() * rng.uniform(0.2, 1.0)
            wanted, _ = model.run(u, model.virgin_memory())
            y, _ = truth.run(u, truth.virgin_memory())
            slope = np.diff(y) / np.diff(wanted)
            least, most = min(least, slope.min()), max(most, slope.max())
            worst = max(worst, np.abs(y - wanted).max())
    centre = bounds.gain_m_per_V / LATERAL_m_per_V
    assert bounds.slope_min * centre <= least * ATTAINED
    assert most <= bounds.slope_max * centre * ATTAINED
    assert 0.3 * bounds.error_m < worst <= bounds.error_m * ATTAINED
    assert (bounds.slope_max - bounds.slope_min) * centre < 3.0 * (most - least)


def test_the_sector_of_the_example_is_its_extreme_slopes():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    assert bounds.increment_gain == pytest.approx((1.02 - 0.72) / (1.02 + 0.72))


def test_the_inverse_bound_covers_every_refit_it_was_made_from(rng):
    model = hysteresis(zones=curved())
    refits = [hysteresis(scale, curved()) for scale in np.linspace(0.95, 1.05, 11)]
    bounds = inverse_bounds(
        model, refits, REACH_V, gain_m_per_V=LATERAL_m_per_V, remainder_m=0.0, confidence=1.0
    )
    for refit in refits:
        for _ in range(10):
            u = np.cumsum(rng.normal(size=300))
            u *= REACH_V / np.abs(u).max()
            difference = (
                refit.run(u, refit.virgin_memory())[0] - model.run(u, model.virgin_memory())[0]
            )
            assert np.abs(difference).max() <= bounds.error_m * ATTAINED
    assert (
        bounds.increment_gain < 0.4 * affine_bounds(model, REACH_V, remainder_m=0.0).increment_gain
    )


def test_small_gain_is_the_sector_times_the_loops_peak():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, o = loop(bounds)
    _, found = certificate_of(plant, o, bounds, 1e-4)
    c = linear_controller(o)
    z = np.exp(1j * np.linspace(1e-4, np.pi, 100_001))
    p = [np.polyval(x[::-1], 1 / z) for x in (plant.B, c.R, plant.A, c.S)]
    peak = np.abs(p[0] * p[1] / (p[2] * p[3] + p[0] * p[1])).max()
    assert found.loop_peak == pytest.approx(peak, rel=1e-3)
    assert found.small_gain == pytest.approx(bounds.increment_gain * peak, rel=1e-3)
    assert found.is_guaranteed


@pytest.mark.parametrize("frequency_Hz", [2.0, 10.0, 40.0])
@pytest.mark.parametrize("step_V", [0.0, 5e-3])
def test_the_guaranteed_error_is_never_exceeded_in_closed_loop(frequency_Hz, step_V):
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, o = loop(bounds)
    amplitude_m = 0.6 * REACH_V * LATERAL_m_per_V
    t = np.arange(int(2.5 / frequency_Hz * RATE_Hz)) / RATE_Hz
    reference = amplitude_m * np.sin(2 * np.pi * frequency_Hz * t)
    slew = 2 * np.pi * frequency_Hz * amplitude_m
    path, found = certificate_of(plant, o, bounds, slew, step_V)
    y, u = run_around_hysteresis(o, path, reference, step_V)
    assert np.abs(u).max() <= REACH_V  # the certificate's own condition
    p = path.preview_samples
    error = np.abs(reference[: len(reference) - p] - y[p:]).max()
    assert error <= found.guaranteed_error_m
    assert error >= 0.02 * found.guaranteed_error_m  # a bound nobody could use fails here
    assert found.guaranteed_error_m == pytest.approx(
        found.hysteresis_error_m + found.reference_error_m + found.converter_error_m
    )


def test_an_unstable_member_has_no_certificate():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, o = loop(bounds)
    wrong = plant_from_chain(lateral_chain(8.0 * bounds.gain_m_per_V))
    c = linear_controller(o)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=100.0)
    operation = Operation(reference_slew_m_per_s=1e-4, voltage_step_V=0.0, sensor_noise_rms_m=0.0)
    with pytest.raises(UnstableLoopError, match="has a pole of magnitude"):
        certify([plant, wrong], c.R, c.S, c.T, path=path, bounds=bounds, operation=operation)


def test_the_sector_joins_the_family_as_gains():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, _ = loop(bounds)
    family = with_sector(PlantFamily(members=(plant,)), bounds)
    gains = [member.gain / plant.gain for member in family.members]
    assert gains == pytest.approx([1.0, bounds.slope_min, bounds.slope_max])
    A, B, C = family.members[1].realised()
    at_rest = C @ np.linalg.solve(np.eye(len(A)) - A, B)
    assert at_rest == pytest.approx(family.members[1].gain)


def test_filter_and_preview_take_the_lag_out_of_a_sine():
    bounds = affine_bounds(hysteresis(), REACH_V, remainder_m=0.0)
    plant, o = loop(bounds)
    c = linear_controller(o)
    path = fit_reference_path([plant], c.R, c.S, c.T, band_Hz=100.0)
    assert path.filter.sum() == pytest.approx(1.0, abs=1e-12)
    assert path.error < 0.05 * path.plain_error
    n, f = 4000, 80.0
    reference = np.sin(2 * np.pi * f / RATE_Hz * np.arange(n))
    P = np.convolve(plant.A, c.S)
    P[: len(np.convolve(plant.B, c.R))] += np.convolve(plant.B, c.R)
    through = np.convolve(np.convolve(c.T, path.filter), plant.B)
    y = np.zeros(n)
    for k in range(20, n):
        y[k] = through @ reference[k - len(through) + 1 : k + 1][::-1]
        y[k] -= P[1:] @ y[k - len(P) + 1 : k][::-1]
    p = path.preview_samples
    late = reference[2000 : n - p] - y[2000 + p :]
    assert np.abs(late).max() <= 1.05 * path.error


@pytest.mark.parametrize("taps", [2, 3, 7, 9])
def test_sections_multiply_to_the_filter_with_unit_gain_at_rest(taps, rng):
    coefficients = rng.normal(size=taps)
    coefficients /= coefficients.sum()
    sections = filter_sections(coefficients)
    assert sections.shape == ((taps) // 2, 5)
    np.testing.assert_allclose(sections[:, :3].sum(axis=1), 1.0, rtol=1e-12)
    together = np.ones(1)
    for section in sections:
        together = np.convolve(together, section[:3])
    np.testing.assert_allclose(together[:taps], coefficients, atol=1e-9)
    np.testing.assert_allclose(together[taps:], 0.0, atol=1e-12)
