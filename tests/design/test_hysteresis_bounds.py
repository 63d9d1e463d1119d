"""Bounds of what hysteresis leaves: never exceeded, nearly attained, a sector of gains."""

import numpy as np
import pytest

from piezoid.design.hysteresis_bounds import affine_bounds, inverse_bounds
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii
from tests.design.hysteretic import ATTAINED, REACH_V, curved, hysteresis
from tests.design.rig import LATERAL_m_per_V


def bent(by: float = 0.0) -> DeadZones:
    return DeadZones(
        threshold=np.array([-1.0, 0.0, 1.5]), weight=np.array([-0.08, 1.05 + by, 0.06])
    )


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
    assert bounds.slope_min + bounds.slope_max == pytest.approx(2.0)
    centre = bounds.gain_m_per_V / LATERAL_m_per_V
    assert bounds.slope_min * centre <= least * ATTAINED
    assert most <= bounds.slope_max * centre * ATTAINED
    assert 0.3 * bounds.error_m < worst <= bounds.error_m * ATTAINED
    assert (bounds.slope_max - bounds.slope_min) * centre < 3.0 * (most - least)


def test_what_one_part_has_too_much_and_another_too_little_is_not_added_up(rng):
    plain = hysteresis()
    reach_m = float(plain.plays.loading_curve(np.array([REACH_V]))[0])
    more = DeadZones(
        threshold=np.array([-0.2 * reach_m, 0.0, 0.2 * reach_m]), weight=np.array([0.2, 1.0, 0.2])
    )
    less = DeadZones(
        threshold=np.array([-0.2, 0.0, 0.2]) * REACH_V, weight=np.array([-0.16, 1.0, -0.16])
    )
    truth = hysteresis(zones=more, envelope=less)
    bounds = inverse_bounds(
        plain, [truth], REACH_V, gain_m_per_V=LATERAL_m_per_V, remainder_m=0.0, confidence=1.0
    )
    worst = 0.0
    for _ in range(200):
        u = np.cumsum(rng.normal(size=300))
        u *= REACH_V / np.abs(u).max() * rng.uniform(0.5, 1.0)
        apart = truth.run(u, truth.virgin_memory())[0] - plain.run(u, plain.virgin_memory())[0]
        worst = max(worst, np.abs(apart).max())
    bends_m = 0.8 * 0.2 * reach_m  # what either part alone does at the end of the range
    assert worst <= bounds.error_m < 2.0 * worst
    assert bounds.error_m < 0.2 * bends_m
