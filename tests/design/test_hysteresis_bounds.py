"""Bounds of the error by hysteresis and of the sector of gains."""

import numpy as np
import pytest

from piezoid.design.hysteresis_bounds import affine_bounds, inverse_bounds
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from tests.design.hysteretic import REACH_V, ROUNDING_FACTOR, curved, hysteresis, random_drives
from tests.design.rig import LATERAL_m_per_V


def envelope_curve(change: float = 0.0) -> DeadZones:
    return DeadZones(
        threshold=np.array([-1.0, 0.0, 1.5]), weight=np.array([-0.08, 1.05 + change, 0.06])
    )


def test_the_affine_bound_is_never_exceeded_and_nearly_attained(rng):
    for zones, envelope in ((LINEAR, LINEAR), (curved(), LINEAR), (LINEAR, envelope_curve())):
        model = hysteresis(zones=zones, envelope=envelope)
        bounds = affine_bounds(model, REACH_V, remainder_m=0.0)
        max_error_m, min_slope, max_slope = 0.0, np.inf, 0.0
        for u in random_drives(rng, 60):
            y, _ = model.run(u, model.virgin_memory())
            max_error_m = max(max_error_m, np.abs(y - bounds.gain_m_per_V * u).max())
            slope = np.diff(y) / np.diff(u) / bounds.gain_m_per_V
            min_slope, max_slope = min(min_slope, slope.min()), max(max_slope, slope.max())
        assert 0.5 * bounds.error_m < max_error_m <= bounds.error_m * ROUNDING_FACTOR
        assert bounds.slope_min - 1e-9 <= min_slope
        assert max_slope <= bounds.slope_max + 1e-9
        assert bounds.slope_min + bounds.slope_max == pytest.approx(2.0)


def single_play(envelope: DeadZones = LINEAR) -> ModifiedPrandtlIshlinskii:
    plays = PrandtlIshlinskii(threshold=np.zeros(1), weight=np.array([LATERAL_m_per_V]))
    return ModifiedPrandtlIshlinskii(plays=plays, dead_zones=LINEAR, envelope=envelope)


KINKED = DeadZones(threshold=np.array([-3e-6, 0.0, 3e-6]), weight=np.array([0.4, 1.0, 0.4]))


ERRORS = (-0.1, -0.05, 0.05, 0.1)


@pytest.mark.parametrize(
    ("model", "truths"),
    [
        pytest.param(
            hysteresis(zones=curved(), envelope=envelope_curve()),
            [hysteresis(1.0 + a, curved(), envelope_curve(0.3 * a)) for a in ERRORS],
            id="errors of all parts",
        ),
        pytest.param(
            single_play(envelope_curve()),
            [single_play(envelope_curve(a)) for a in ERRORS],
            id="envelope alone",
        ),
        pytest.param(
            hysteresis(zones=KINKED),
            [hysteresis(1.0 + 4.0 * a, KINKED) for a in ERRORS],
            id="truth beyond a kink of the model",
        ),
    ],
)
def test_the_error_of_the_inverse_stays_within_its_bounds(model, truths, rng):
    bounds = inverse_bounds(
        model, truths, REACH_V, gain_m_per_V=LATERAL_m_per_V, remainder_m=0.0, confidence=1.0
    )
    min_slope, max_slope, max_error_m = np.inf, 0.0, 0.0
    for truth in truths:
        for u in random_drives(rng, 30):
            model_m, _ = model.run(u, model.virgin_memory())
            y, _ = truth.run(u, truth.virgin_memory())
            slope = np.diff(y) / np.diff(model_m)
            min_slope, max_slope = min(min_slope, slope.min()), max(max_slope, slope.max())
            max_error_m = max(max_error_m, np.abs(y - model_m).max())
    assert bounds.slope_min + bounds.slope_max == pytest.approx(2.0)
    centre = bounds.gain_m_per_V / LATERAL_m_per_V
    assert bounds.slope_min * centre <= min_slope * ROUNDING_FACTOR
    assert max_slope <= bounds.slope_max * centre * ROUNDING_FACTOR
    assert 0.3 * bounds.error_m < max_error_m <= bounds.error_m * ROUNDING_FACTOR
    assert (bounds.slope_max - bounds.slope_min) * centre < 3.0 * (max_slope - min_slope)


def test_opposite_errors_of_two_parts_cancel_in_the_bound(rng):
    model = hysteresis()
    reach_m = float(model.plays.loading_curve(np.array([REACH_V]))[0])
    zones = DeadZones(
        threshold=np.array([-0.2 * reach_m, 0.0, 0.2 * reach_m]), weight=np.array([0.2, 1.0, 0.2])
    )
    envelope = DeadZones(
        threshold=np.array([-0.2, 0.0, 0.2]) * REACH_V, weight=np.array([-0.16, 1.0, -0.16])
    )
    truth = hysteresis(zones=zones, envelope=envelope)
    bounds = inverse_bounds(
        model, [truth], REACH_V, gain_m_per_V=LATERAL_m_per_V, remainder_m=0.0, confidence=1.0
    )
    max_error_m = 0.0
    for u in random_drives(rng, 200, samples=300, min_share=0.5):
        difference_m = (
            truth.run(u, truth.virgin_memory())[0] - model.run(u, model.virgin_memory())[0]
        )
        max_error_m = max(max_error_m, np.abs(difference_m).max())
    bends_m = 0.8 * 0.2 * reach_m  # error of either part alone at the end of the range
    assert max_error_m <= bounds.error_m < 2.0 * max_error_m
    assert bounds.error_m < 0.2 * bends_m
