"""What happens to a tip: a guarded one survives all of it, and each missing guard is seen."""

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
BACK = "time until the current recovers"


def verdicts(*names, limits=None, **changed):
    axis = stage("z").axes[0]
    values = {**axis.values, **changed}
    file = ParameterFile(name="tip", axes=(AxisParameters(axis="z", values=values),))
    chosen = [TRIALS[name] for name in names] if names else TIP_TRIALS
    found = verify(file, PLANTS[2:], scenarios=(), trials=chosen, limits=limits).verdicts
    return {(verdict.scenario, verdict.name): verdict for verdict in found[1:]}


def test_a_guarded_tip_survives_everything():
    found = verdicts()
    assert {scenario for scenario, _ in found} == set(TRIALS)
    assert [v for v in found.values() if not v.passed] == []
    assert all(found[name, CLOSER].value < 0.4e-9 for name in TRIALS)
    latching = {name for name, trial in TRIALS.items() if trial.cause}
    assert all((name, LATCHED) in found for name in latching)


def test_a_fast_approach_runs_into_the_surface():
    """2.16 nm a sample, as a controller moves that sees only the floor."""
    found = verdicts("approach from 200 nm", approach_step_V=0.12)
    assert found["approach from 200 nm", CLOSER].value > 1e-9


def test_a_search_without_an_end_follows_a_dead_amplifier_to_the_drives_end():
    dead = verdicts("amplifier dead", search_voltage_V=0.0)["amplifier dead", CLOSER]
    assert dead.value > 1e-8
    assert not dead.passed


def test_retracts_that_never_latch_are_seen():
    assert not verdicts("bias reversed", trip_limit=0)["bias reversed", LATCHED].passed


def test_a_frozen_reading_that_nobody_watches_for_is_seen():
    found = verdicts("reading frozen for good", stuck_samples=0)
    assert not found["reading frozen for good", CLOSER].passed


def test_a_tip_that_retracts_all_the_way_comes_back_too_late():
    found = verdicts("reading NaN for 1.25 ms", retract_step_V=0.0)
    assert not found["reading NaN for 1.25 ms", BACK].passed


def test_a_wider_search_brings_the_tip_back_over_a_larger_step():
    """2.5 nm instead of 0.35 nm: 2 nm are found again, and a dead amplifier costs as much."""
    wide = 0.0194 * 2.5 / 0.35
    found = verdicts("surface steps down", "amplifier dead", search_voltage_V=wide)
    assert ("surface steps down", LATCHED) not in found
    assert found["surface steps down", BACK].passed
    assert found["amplifier dead", CLOSER].value == pytest.approx(2.5e-9, rel=0.05)


def test_limits_are_the_laboratorys_to_say():
    strict = limits_from_toml("closest_m = 1e-10\nrecovery_s = 0.01\napproach_s = 0.5")
    found = verdicts("amplifier dead", "reading NaN for 20 ms", limits=strict)
    assert not found["amplifier dead", CLOSER].passed
    assert not found["reading NaN for 20 ms", BACK].passed
    assert math.isclose(found["amplifier dead", CLOSER].limit, 1e-10)
