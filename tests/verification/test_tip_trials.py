"""Trials of a tip: a guarded tip passes all of them, and each missing guard fails one."""

import math

import pytest

from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.verification.criteria import limits_from_toml
from piezoid.verification.tip_trials import TIP_TRIALS
from piezoid.verification.verify import verify
from tests.verification.rig import PLANTS, stage

TRIALS = {trial.name: trial for trial in TIP_TRIALS}
CLOSER = "closer to the surface than the set point"
LATCHED = "faults not latched with their cause"
RECOVERY = "time until the current recovers"


def verdicts(*names, limits=None, **overrides):
    axis = stage("z").axes[0]
    values = {**axis.values, **overrides}
    file = ParameterFile(name="tip", axes=(AxisParameters(axis="z", values=values),))
    trials = [TRIALS[name] for name in names] if names else TIP_TRIALS
    results = verify(file, PLANTS[2:], scenarios=(), trials=trials, limits=limits).verdicts
    return {(verdict.scenario, verdict.name): verdict for verdict in results[1:]}


def test_a_guarded_tip_passes_every_trial():
    results = verdicts()
    assert {scenario for scenario, _ in results} == set(TRIALS)
    assert [v for v in results.values() if not v.passed] == []
    assert all(results[name, CLOSER].value < 0.4e-9 for name in TRIALS)
    latching = {name for name, trial in TRIALS.items() if trial.cause}
    assert all((name, LATCHED) in results for name in latching)


@pytest.mark.parametrize(
    ("trial", "missing", "name", "above"),
    [
        # The step is 2.16 nm per sample, that of a controller that checks only the floor.
        ("approach from 200 nm", {"approach_step_V": 0.12}, CLOSER, 1e-9),
        # Without this limit the search follows the amplifier to the drive limit.
        ("amplifier dead", {"search_voltage_V": 0.0}, CLOSER, 1e-8),
        ("bias reversed", {"trip_limit": 0}, LATCHED, 0.0),
        ("reading frozen for good", {"stuck_samples": 0}, CLOSER, 0.0),
        ("reading NaN for 1.25 ms", {"retract_step_V": 0.0}, RECOVERY, 0.0),
    ],
)
def test_a_missing_guard_fails_a_trial(trial, missing, name, above):
    verdict = verdicts(trial, **missing)[trial, name]
    assert not verdict.passed
    assert verdict.value > above


def test_a_wider_search_brings_the_tip_back_over_a_larger_step():
    """A search of 2.5 nm recovers a step of 2 nm; a dead amplifier moves the tip 2.5 nm."""
    wide = 0.0194 * 2.5 / 0.35
    results = verdicts("surface steps down", "amplifier dead", search_voltage_V=wide)
    assert ("surface steps down", LATCHED) not in results
    assert results["surface steps down", RECOVERY].passed
    assert results["amplifier dead", CLOSER].value == pytest.approx(2.5e-9, rel=0.05)


def test_trials_use_the_limits_of_the_laboratory():
    strict = limits_from_toml("closest_m = 1e-10\nrecovery_s = 0.01\napproach_s = 0.5")
    results = verdicts("amplifier dead", "reading NaN for 20 ms", limits=strict)
    assert not results["amplifier dead", CLOSER].passed
    assert not results["reading NaN for 20 ms", RECOVERY].passed
    assert math.isclose(results["amplifier dead", CLOSER].limit, 1e-10)
