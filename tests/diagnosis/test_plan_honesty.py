"""A plan states where no drive helps and which limit prevents it; its predictions are sound."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from piezoid.diagnosis.candidate import MINIMUM_SHARE
from piezoid.diagnosis.diagnosis import NO_RECORDING, Diagnosis
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
from piezoid.diagnosis.effect import Tangent
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.experiment import (
    Alternative,
    CandidateTable,
    Plan,
    plan,
    simulate_candidates,
)
from piezoid.diagnosis.planning.candidate_drives import EXPERIMENTS, drive_of
from piezoid.diagnosis.planning.drive_limits import Bench, DriveLimits, bench_of
from piezoid.diagnosis.planning.open_questions import (
    expected_limit_m,
    questions_of,
)
from piezoid.diagnosis.planning.plan_file import sentences, standard_error
from piezoid.diagnosis.planning.separation import SeparationEstimate
from piezoid.errors import ExcitationError
from piezoid.records.lab import Amplifier, Lab
from piezoid.statement import Level
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model

MODEL = stage_model(axis_model("x"), axis_model("y"))
CLOCK_Hz = 1000.0
HIGH_m = 2e-8  # detection limit that leaves an open question


def _diagnosis_with_limits(**limit_m: float) -> Diagnosis:
    """Return a diagnosis without findings; only these effects have a high detection limit."""
    diagnosis = diagnosed()
    not_detected = tuple(
        replace(absent, detection_limit_m=limit_m.get(absent.effect, 1e-12), upper_bound_m=1e-12)
        for absent in diagnosis.not_detected
    )
    return replace(diagnosis, not_detected=not_detected)


def _plan_of(diagnosis: Diagnosis, slew_V_per_s: float | None = None, **request: str) -> Plan:
    lab = Lab(amplifier=Amplifier(slew_V_per_s=slew_V_per_s))
    return plan(MODEL, diagnosis, lab=lab, clock_Hz=CLOCK_Hz, **request)


@cache
def _slow_plan() -> Plan:
    return _plan_of(_diagnosis_with_limits(delay=HIGH_m), 2.0, effect="delay")


@cache
def _table() -> CandidateTable:
    axis = MODEL["x"]
    bench = bench_of(MODEL, axis, Lab(), (), CLOCK_Hz)
    return simulate_candidates(axis, bench, diagnosed(), (), 0)


@pytest.mark.parametrize(
    "effect", [effect.name for effect in EFFECTS if isinstance(effect.tangent, Tangent)]
)
def test_the_predicted_limit_is_not_below_what_the_diagnosis_can_name(effect):
    diagnosis = _diagnosis_with_limits(**{effect: HIGH_m})
    (question,) = questions_of(diagnosis, effect)
    alternative = _table().plan(question).best
    if alternative.estimate is not None and alternative.score > 0.0:
        limit_m = expected_limit_m(question, None, alternative.estimate)
        assert limit_m >= MINIMUM_SHARE * diagnosis.stroke_m


def test_an_unexcited_coupling_is_planned_with_a_drive_of_the_other_axis():
    diagnosis = diagnosed()
    not_detected = tuple(
        replace(absent, detection_limit_m=None, upper_bound_m=None)
        if absent.effect == "cross_coupling"
        else absent
        for absent in diagnosis.not_detected
    )
    (question,) = questions_of(replace(diagnosis, not_detected=not_detected), "cross_coupling")
    alternative = _table().plan(question).best
    assert alternative.name == "other_axis"
    assert 1e-6 < alternative.estimate.errors[0] < 1.0


def test_a_drive_waits_for_slower_axes():
    slow = DriveLimits(voltage_min_V=0.0, voltage_max_V=10.0, slew_V_per_s=1.0)
    fast = replace(slow, slew_V_per_s=50.0)
    bench = Bench(axis="x", limits=fast, clock_Hz=CLOCK_Hz, other_limits={"y": slow, "z": fast})
    drive = drive_of(next(e for e in EXPERIMENTS if e.name == "other_axis"), bench, 0)
    is_constant = drive.voltage_V[:, 0] == 5.0
    for k in (1, 2):
        moving = np.abs(np.diff(drive.voltage_V[:, k])) > 0.0
        loops = moving & (drive.voltage_V[1:, k] > 1.0)
        assert is_constant[1:][loops].mean() > 0.7


def test_a_plan_names_the_speed_limit_and_the_speed_that_it_needs():
    slow_plan = _slow_plan()
    assert not slow_plan.answers
    assert "No drive answers this question within these limits" in sentences(slow_plan)[1]
    match = re.search(
        r"The limit is the speed, 2 V/s .*slew_V_per_s.* leave (\d+) % .* not (\d+) %",
        slow_plan.forbids,
    )
    faster_plan = _plan_of(_diagnosis_with_limits(delay=HIGH_m), 8.0, effect="delay")
    remaining_share = faster_plan.remaining_share
    assert 100 * remaining_share == pytest.approx(float(match[1]), abs=0.6)
    assert remaining_share < slow_plan.remaining_share


def test_a_question_without_a_suitable_drive_is_replaced_by_another():
    diagnosis = _diagnosis_with_limits(delay=HIGH_m, thermal_drift=1e-8)
    plan_within_speed = _plan_of(diagnosis, 2.0)
    assert plan_within_speed.answers
    assert plan_within_speed.question.effects == ("thermal_drift",)
    assert [question.effects for question in plan_within_speed.set_aside] == [("delay",)]
    assert "More important, but answered by no drive" in sentences(plan_within_speed)[-1]
    assert "whether there is delay" in sentences(plan_within_speed)[-1]


def test_no_coupling_is_planned_for_a_stage_of_one_axis():
    diagnosis = _diagnosis_with_limits(cross_coupling=HIGH_m, thermal_drift=1e-8)
    one_axis_plan = plan(stage_model(axis_model("x")), diagnosis, clock_Hz=CLOCK_Hz)
    assert one_axis_plan.question.effects == ("thermal_drift",)
    assert one_axis_plan.set_aside == ()
    assert _plan_of(diagnosis).question.effects == ("cross_coupling",)


def test_an_effect_with_a_low_detection_limit_needs_no_recording():
    delay_plan = _plan_of(_diagnosis_with_limits(), effect="delay")
    assert not delay_plan.answers
    assert not delay_plan.forbids
    assert "no recording is needed" in sentences(delay_plan)[0]


@pytest.mark.parametrize(
    ("share", "text"), [(0.9998, "99.98 %"), (0.986, "98.6 %"), (0.43, "43 %"), (0.005, "0.5 %")]
)
def test_a_separability_near_one_keeps_the_digits_of_its_distance(share, text):
    diagnosis = diagnosed(finding("creep", rivals=("thermal_drift",)))
    creep_plan = _plan_of(diagnosis, effect="creep")
    estimate = SeparationEstimate(separability=share, errors=(0.1, 0.1))
    best = replace(creep_plan.best, estimate=estimate)
    changed = replace(creep_plan, best=best, recorded=estimate)
    assert f"separability of the two: {text} (now {text})" in " ".join(sentences(changed))


def test_every_advised_drive_is_a_candidate():
    tangents = [e.tangent for e in EFFECTS if isinstance(e.tangent, Tangent)]
    names = {experiment.name for experiment in EXPERIMENTS}
    assert {name for tangent in tangents for name in tangent.advised} <= names


def test_a_plan_with_another_drive_than_the_report_states_both():
    creep_plan = _plan_of(diagnosed(finding("creep", rivals=("thermal_drift",))), effect="creep")
    (advised,) = (a for a in creep_plan.alternatives if a.name == "held_levels_mirrored")
    (curves,) = (a for a in creep_plan.alternatives if a.name == "reversal_curves")
    question = creep_plan.question
    for chosen, is_compared in ((curves, True), (advised, False)):
        comparison = [s for s in sentences(replace(creep_plan, best=chosen)) if "report" in s]
        assert bool(comparison) is is_compared
        for alternative in (curves, advised) if is_compared else ():
            assert f"{alternative.duration_s:.0f} s" in comparison[0]
            assert standard_error(question, alternative.estimate) in comparison[0]


def test_confounded_effects_that_a_recording_separates_are_no_question():
    open_pair = diagnosed(finding("delay", rivals=("resonance",)))
    answer = f"{NO_RECORDING}: a chirp separates them."
    answered = diagnosed(finding("delay", rivals=("resonance",), experiment=answer))
    assert "separate" in {question.kind for question in questions_of(open_pair, "delay")}
    assert "separate" not in {question.kind for question in questions_of(answered, "delay")}
    levels = {fact.quantity: fact.level for fact in diagnosis_statements(answered)}
    assert levels["delay_confounded"] is Level.WARNING


@pytest.mark.parametrize("is_declared", [True, False])
def test_the_origin_of_the_speed_limit_is_stated(is_declared):
    diagnosis = _diagnosis_with_limits(thermal_drift=1e-8)
    if is_declared:
        drive = sentences(_plan_of(diagnosis, 8.0))[1]
        assert "at most 8.00 V/s (as fast as lab.toml allows" in drive
    else:
        drive = sentences(_plan_of(diagnosis))[1]
        assert "(the fastest drive of the recordings, because lab.toml declares no slew" in drive


def test_a_diagnosis_without_open_questions_has_no_plan():
    with pytest.raises(ExcitationError, match="no open question"):
        _plan_of(_diagnosis_with_limits())


@pytest.mark.parametrize(("errors", "is_answered"), [((2.0, 0.1), False), ((0.1, 0.1), True)])
def test_two_effects_below_their_errors_are_not_separated(errors, is_answered):
    question = questions_of(diagnosed(finding("creep", rivals=("thermal_drift",))), "creep")[0]
    dissimilar = SeparationEstimate(separability=0.9, errors=errors)
    alternative = Alternative(name="drive", why="", estimate=dissimilar, score=1.0)
    bench = bench_of(MODEL, MODEL["x"], Lab(), (), CLOCK_Hz)
    drive_plan = Plan(
        question=question,
        alternatives=(alternative,),
        best=alternative,
        recorded=None,
        bench=bench,
    )
    assert drive_plan.answers is is_answered
