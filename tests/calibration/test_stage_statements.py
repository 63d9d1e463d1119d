"""Statements of a stage and their levels."""

from dataclasses import replace
from typing import Any

import pytest

from piezoid.calibration.stage_statements import stage_statements
from piezoid.diagnosis.diagnosis import SOMETHING_ELSE, BudgetPart
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements, largest_first
from piezoid.diagnosis.effects import EFFECTS
from piezoid.identification.fit_statements import Grade, fit_statements, grade_of
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import Limit, with_noise_bound
from piezoid.statement import Level, select
from piezoid.statement import finding as finding_of_recording
from piezoid.verification import criteria
from piezoid.verification.verification import Verification
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import NOISE_m, axis_model, recording, stage_model


def levels(axis: AxisModel) -> dict[str, Level]:
    return {fact.quantity: fact.level for fact in fit_statements(axis)}


def with_quality(**changes: object) -> AxisModel:
    axis = axis_model()
    return replace(axis, quality=replace(axis.quality, **changes))


def with_uncertainty(**changes: object) -> AxisModel:
    axis = axis_model()
    return replace(axis, uncertainty=replace(axis.uncertainty, **changes))


def axis_at_single_speed(score: int) -> AxisModel:
    return with_quality(limits=(Limit(lack="speed", reason="one speed", most=score),))


@pytest.mark.parametrize(
    ("axis", "quantity", "level"),
    [
        (axis_at_single_speed(20), "speed", Level.ACTION),
        (axis_at_single_speed(70), "speed", Level.ACTION),
        (axis_at_single_speed(85), "speed", Level.WARNING),
        (with_quality(converged=False), "convergence", Level.WARNING),
        (with_quality(noise_is_most=True), "noise", Level.WARNING),
        (with_uncertainty(blocks=9), "blocks", Level.WARNING),
        (with_uncertainty(loop_width_m=(1e-6, 3e-7)), "loop_width", Level.WARNING),
    ],
)
def test_each_limitation_of_a_fit_is_stated_with_its_level(axis, quantity, level):
    assert quantity not in levels(axis_model())
    assert levels(axis)[quantity] is level


def test_a_noise_above_the_error_of_the_model_is_an_upper_limit():
    quality = replace(axis_model().quality, rms_m=0.5 * NOISE_m, held_out_rms_m=0.6 * NOISE_m)
    bounded = with_noise_bound(quality)
    assert bounded.noise_rms_m == quality.explained_rms_m
    assert bounded.noise_is_most
    close = with_noise_bound(replace(quality, rms_m=0.97 * NOISE_m, held_out_rms_m=NOISE_m))
    assert close.noise_rms_m < NOISE_m
    assert not close.noise_is_most
    larger = axis_model().quality
    assert with_noise_bound(larger) is larger


def test_an_interval_that_contradicts_the_held_out_error_is_not_stated():
    axis = with_uncertainty(loop_width_m=(5.1e-6, 7.2e-6))
    (fact,) = (fact for fact in fit_statements(axis) if fact.quantity == "loop_width")
    assert "7.2" not in fact.text
    assert "held-out error, 30.0 nm rms" in fact.text


def test_a_baseline_that_drifts_is_stated_with_its_size():
    (drift,) = {
        (fact.value, fact.recording)
        for fact in fit_statements(axis_model())
        if fact.quantity == "baseline_drift"
    }
    assert drift == (pytest.approx(2e-7), "sweep.csv")


@pytest.mark.parametrize(
    ("changes", "grade"),
    [
        ({}, Grade.GOOD),
        ({"held_out_rms_m": 2.4e-7}, Grade.LIMITED),  # 1 % of the range
        ({"held_out_rms_m": 7.2e-7}, Grade.POOR),
        ({"held_out_rms_m": 7.2e-7, "noise_rms_m": 7e-7}, Grade.GOOD),
        ({"limits": (Limit(lack="branch", reason="one branch", most=20),)}, Grade.POOR),
        ({"limits": (Limit(lack="speed", reason="one speed", most=50),)}, Grade.LIMITED),
    ],
)
def test_the_grade_follows_error_noise_and_limits(changes, grade):
    assert grade_of(with_quality(**changes)) is grade


def test_an_inapplicable_model_class_is_the_first_action():
    axis = axis_model(reason="the loop opens the wrong way")
    assert grade_of(axis) is Grade.REJECTED
    first = select(stage_statements(stage_model(axis)))[0]
    assert (first.quantity, first.level) == ("model_class", Level.ACTION)


@pytest.mark.parametrize("effect", [effect.name for effect in EFFECTS])
def test_confounded_effects_request_their_experiment(effect):
    diagnosis = diagnosed(
        finding(effect, rivals=("thermal_drift",), experiment="Record a staircase.")
    )
    (fact,) = [f for f in diagnosis_statements(diagnosis) if f.quantity == f"{effect}_confounded"]
    assert fact.level is Level.ACTION
    assert fact.text.endswith("Record a staircase.")


def test_an_unexplained_error_without_findings_requests_a_recording():
    diagnosis = replace(diagnosed(), budget=())
    (fact,) = diagnosis_statements(diagnosis)
    assert (fact.quantity, fact.level, fact.value) == (
        "no_effect_detected",
        Level.ACTION,
        diagnosis.envelope_rms_m,
    )
    noise_level = replace(diagnosis, envelope_rms_m=5.5e-9)
    assert diagnosis_statements(noise_level)[0].level is Level.NOTE
    assert diagnosis_statements(replace(diagnosed(finding("delay")), budget=())) == ()


def test_a_diagnosis_without_tests_states_the_reason():
    diagnosis = diagnosed()
    untested = tuple(
        replace(effect, upper_bound_m=None, detection_limit_m=None, reason="the loop is open")
        for effect in diagnosis.not_detected
    )
    (fact,) = diagnosis_statements(replace(diagnosis, not_detected=untested))
    assert fact.quantity == "no_effect_tested"
    assert "the loop is open" in fact.text
    unexplained = replace(diagnosed(finding("something_else")), not_detected=untested, budget=())
    assert "no_effect_tested" in {fact.quantity for fact in diagnosis_statements(unexplained)}


@pytest.mark.parametrize(
    ("part", "error_percent", "level"),
    [
        ("loop_shape", 1.0, Level.WARNING),
        ("extrapolation", 1.0, Level.ACTION),
        ("extrapolation", 0.2, Level.WARNING),  # of a model that is good
    ],
)
def test_the_dominant_part_of_the_remaining_error_is_stated(part, error_percent, level):
    large = BudgetPart(part=part, rms_m=2.9e-8, is_explained=False, text="What it is.")
    diagnosis = replace(diagnosed(finding("delay")), budget=(large,))
    final = replace(diagnosis.final, rms_percent=error_percent)
    diagnosis = replace(diagnosis, final=final)
    (fact,) = diagnosis_statements(diagnosis)
    assert (fact.quantity, fact.level, fact.value) == (part, level, 2.9e-8)
    small = replace(diagnosis, budget=(replace(large, rms_m=1.5e-8),))
    assert diagnosis_statements(small)[0].level is Level.WARNING
    noise_level = replace(diagnosis, final=replace(diagnosis.final, rms_m=5.5e-9))
    assert diagnosis_statements(noise_level) == ()


def test_an_unexplained_finding_is_first_only_if_it_is_the_largest():
    large, small = (finding(SOMETHING_ELSE, share=share) for share in (5e-3, 1e-3))
    creep = finding("creep", share=3e-3)
    assert largest_first(diagnosed(creep, large))[0].effect == SOMETHING_ELSE
    assert largest_first(diagnosed(creep, small))[0].effect == "creep"


def verification(value: float) -> Verification:
    verdict = criteria.Verdict(
        name="tracking", scenario="spiral", value=value, limit=0.5, unit="m"
    )
    return Verification(
        name="bench",
        methods={"x": "mpi"},
        radius_m=1e-6,
        comparison=(),
        spirals=(),
        currents=(),
        traces=(),
        verdicts=(verdict,),
        proofs=(),
        plants=(),
        parameters_digest="sha256:" + "0" * 64,
        runtime_digest="sha256:" + "0" * 64,
    )


def test_a_failed_verdict_and_an_axis_that_does_not_ship_need_action_once():
    model, failed = stage_model(axis_model()), verification(0.9)

    def actions_of(result: Verification, **reasons: Any) -> set[tuple[str, str]]:
        facts = stage_statements(model, verification=result, **reasons)
        return {(f.axis, f.quantity) for f in select(facts, minimum=Level.ACTION)}

    actions = actions_of(failed, unshipped={"y": "no margin"}, undesigned="no sampling rate")
    assert actions == {("", "tracking"), ("y", "not_shipped"), ("", "not_designed")}
    assert not actions_of(verification(0.2))
    reason = f"failed: {criteria.describe_failure(failed.verdicts[0])}. Record more."
    assert actions_of(failed, unshipped={"x": reason}) == {("x", "not_shipped")}


def test_no_statement_is_made_twice():
    facts = stage_statements(
        stage_model(axis_model()),
        recordings=[recording()],
        diagnoses=[diagnosed(finding("creep", rivals=("lag",)))],
        undiagnosed=("axis z is not diagnosed.",),
    )
    assert len({fact.text for fact in facts}) == len(facts)


def test_a_remark_of_the_model_about_a_recording_is_one_statement_that_needs_action():
    rate = finding_of_recording("controller_rate", "No time column.")
    remarked = replace(recording(), statements=(rate,))
    model = replace(
        stage_model(axis_model()), remarks=(f"{remarked.name}: {rate.text}", "no junction")
    )
    facts = stage_statements(model, recordings=[remarked])
    actions = {fact.quantity: fact.text for fact in facts if fact.level is Level.ACTION}
    assert actions["controller_rate"] == f"{remarked.name}: {rate.text}"
    assert actions["recordings"] == "no junction"
    assert len({fact.text for fact in facts}) == len(facts)


def test_a_fault_of_the_recordings_precedes_the_rejected_model():
    rejected = stage_model(axis_model(reason="the loop opens the wrong way"))
    model = replace(rejected, remarks=("Several drives move one displacement.",))
    first, second, *_ = select(stage_statements(model), minimum=Level.ACTION)
    assert (first.quantity, second.quantity) == ("recordings", "model_class")
