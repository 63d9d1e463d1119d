"""Bounds and detection limits of effects that are not named, for a known score test."""

from dataclasses import replace

import pytest

from piezoid.diagnosis.candidate import Outcome
from piezoid.diagnosis.diagnosis import NotDetected
from piezoid.diagnosis.effects import creep
from piezoid.diagnosis.findings import not_detected
from piezoid.diagnosis.score_test import score_test

from .play_stage import healthy

ABSORPTION = 3.0  # rms of an effect over its part beyond hysteresis


def creep_of_a_healthy_stage(share: float, bound: float) -> NotDetected:
    """Return the limits of creep that is known by a score test, in shares of the stroke."""
    test = replace(
        score_test(creep.EFFECT, healthy()),
        share=share,
        bound=bound,
        floor=0.0,
        absorption=ABSORPTION,
        separable=True,
    )
    outcome = Outcome(
        first=healthy(),
        clean=healthy(),
        final=healthy(),
        faults={},
        causes=(),
        confounded={},
        score_tests={"creep": test},
    )
    return not_detected(creep.EFFECT, outcome)


def test_the_detection_limit_of_a_certain_effect_is_the_smallest_relevant_gain():
    """Without an effect of the limit's size the residual is smaller by the minimum gain."""
    limit_m = creep_of_a_healthy_stage(0.0, 0.0).detection_limit_m
    part = limit_m / ABSORPTION / healthy().half_stroke_m / healthy().rms
    gain = 1.0 - (1.0 - part**2) ** 0.5
    assert gain == pytest.approx(creep.EFFECT.minimum_gain, rel=0.05)


def test_a_bound_includes_what_hysteresis_absorbs():
    stroke_m = 2.0 * healthy().half_stroke_m
    uncertain = creep_of_a_healthy_stage(0.01, 0.05)
    assert uncertain.upper_bound_m == pytest.approx(ABSORPTION * 0.05 * stroke_m)
    # four in five effects of size d exceed a bound of 1.645 sigma if d = (1.645 + 0.84) sigma
    assert uncertain.detection_limit_m > ABSORPTION * 0.04 * stroke_m * 2.4 / 1.645
    assert creep_of_a_healthy_stage(0.05, 0.05).detection_limit_m == uncertain.upper_bound_m


@pytest.mark.parametrize(("bound", "is_bounded"), [(0.9, True), (1.1, False)])
def test_a_bound_above_the_range_is_no_bound(bound, is_bounded):
    absent = creep_of_a_healthy_stage(0.0, bound / ABSORPTION)
    assert (absent.upper_bound_m is not None) is is_bounded
    assert (absent.detection_limit_m is not None) is is_bounded
