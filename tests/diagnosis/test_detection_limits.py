"""Why what seems to be evidence by itself was not named is said."""

from collections.abc import Mapping

import numpy as np
import pytest

from piezoid.diagnosis.blocked_regression import CrossValidated
from piezoid.diagnosis.candidate import MINIMUM_Z
from piezoid.diagnosis.detection_limits import absent
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import NotDetected
from piezoid.diagnosis.effect import BETWEEN, Effect, Trial
from piezoid.diagnosis.effects import gain_change, lag, slew_limit, thermal_drift
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import ScoreTest
from piezoid.diagnosis.selection import Outcome
from piezoid.diagnosis.signals import with_displacement
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import causes, recorded
from .leaving import STROKE_m, candidate_of, view_leaving

DRIFT = thermal_drift.EFFECT
DRIFT_m = 1e-8  # at the end, of 46 um
NOISY = view_leaving(0.01)


def reason(
    *,
    gain: float,
    z: float,
    sound: bool = True,
    causes: tuple[Effect, ...] = (),
    held: bool = False,
) -> str:
    """Return what is said of a drift that was seen so clearly and not named."""
    return drift(gain=gain, z=z, sound=sound, causes=causes, held=held).reason


def drift(
    *,
    gain: float = 0.0,
    z: float = 0.0,
    sound: bool = True,
    causes: tuple[Effect, ...] = (),
    held: bool = False,
    veiled: float = 1.0,
) -> NotDetected:
    found = seen(DRIFT, gain=gain, z=z, veiled=veiled, sound=sound)
    return absent(DRIFT, outcome_of({DRIFT.name: found}, causes, held=held))


def brings(gain: float, z: float) -> CrossValidated:
    return CrossValidated(
        gain=gain, z=z, coefficient=np.ones(1), spread=np.zeros(1), loss=np.ones(40), rms=0.01
    )


def seen(
    effect: Effect,
    *,
    bound: float = 0.002,
    gain: float = 0.0,
    z: float = 0.0,
    veiled: float = 1.0,
    sound: bool = True,
) -> ScoreTest:
    return ScoreTest(
        effect=effect,
        trial=Trial(columns=np.ones((1, 1))),
        cv=brings(gain, z),
        placebo=None,
        share=0.001,
        bound=bound,
        floor=0.0,
        absorption=veiled,
        physical=sound,
        separable=True,
        total_gain=gain,
    )


def outcome_of(
    screened: Mapping[str, ScoreTest],
    causes: tuple[Effect, ...] = (),
    *,
    held: bool = False,
    final: View = NOISY,
) -> Outcome:
    """Return a search that left a hundredth of half the stroke."""
    named = (candidate_of(one, brings(0.5, 9.0), without=final, view=final) for one in causes)
    return Outcome(
        first=final,
        clean=final,
        final=final,
        faults={},
        causes=tuple(named),
        confounded={},
        screened=screened,
        held_back=(DRIFT.name,) if held else (),
    )


def test_what_physics_does_not_allow_is_said_to_be_unsound() -> None:
    assert "physics allows it no such size" in reason(gain=0.5, z=9.0, sound=False)


def test_what_is_sure_and_sound_may_be_what_the_causes_leave_over() -> None:
    alone = reason(gain=0.5, z=9.0)
    assert "not named, because refitted with everything else it is no better" in alone
    assert "leave over" not in alone
    beside = reason(gain=0.5, z=9.0, causes=(slew_limit.EFFECT, lag.EFFECT))
    assert "or may be what slew limit, lag leave over" in beside


def test_what_is_no_larger_than_the_structure_that_is_left_says_so() -> None:
    sure = seen(DRIFT, gain=0.5, z=9.0)
    left = absent(DRIFT, outcome_of({DRIFT.name: sure}, final=view_leaving(0.01, structure=2.0)))
    assert "no larger than what no hysteresis here follows" in left.reason


@pytest.mark.parametrize(
    ("gain", "z"), [(0.99 * DRIFT.minimum_gain, 9.0), (0.5, 0.99 * MINIMUM_Z), (0.0, 0.0)]
)
def test_what_is_no_evidence_by_itself_needs_no_excuse(gain, z) -> None:
    for sound in (True, False):
        assert "not named" not in reason(gain=gain, z=z, sound=sound, causes=(lag.EFFECT,))


def test_structure_that_was_held_back_has_one_reason_and_not_two() -> None:
    told = reason(gain=0.5, z=9.0, causes=(lag.EFFECT,), held=True)
    assert told.count("not named") == 1
    assert "do not tell it from what lag may leave over" in told
    alone = reason(gain=0.5, z=9.0, held=True)
    assert alone.endswith("do not tell it from what else no hysteresis here follows")


def test_what_hysteresis_takes_up_of_an_effect_may_be_there_all_the_same() -> None:
    shown, veiled = drift(), drift(veiled=3.0)
    assert shown.upper_bound_m == pytest.approx(0.002 * 2e-5)
    assert veiled.upper_bound_m == pytest.approx(3.0 * shown.upper_bound_m)
    assert veiled.detection_limit_m == pytest.approx(3.0 * shown.detection_limit_m)


def test_a_drift_beside_a_single_sweep_is_bounded_as_it_is_and_not_as_it_shows() -> None:
    (recording,), lab = recorded(draw_campaign(21, truth="preisach", plans=("sweep",)))
    slow_m = DRIFT_m * np.linspace(-1.0, 1.0, recording.samples)
    drifting = with_displacement(recording, recording.displacement_m() + slow_m)
    found = diagnose([drifting], lab=lab)
    assert causes(found) == ()
    bound_m = next(n.upper_bound_m for n in found.not_detected if n.effect == DRIFT.name)
    assert float(np.std(slow_m)) < bound_m < 3.0 * float(np.std(slow_m))


def test_of_two_ways_of_an_effect_the_one_that_may_hide_more_is_told() -> None:
    gain = gain_change.EFFECT
    ways = {gain.name: 0.001, f"{gain.name} {BETWEEN}": 0.004}
    for names in (ways, dict(reversed(ways.items()))):
        told = absent(gain, outcome_of({n: seen(gain, bound=b) for n, b in names.items()}))
        assert told.upper_bound_m == pytest.approx(0.004 * 2.0 * STROKE_m)
