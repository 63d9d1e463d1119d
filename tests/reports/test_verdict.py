"""The verdict on top: three sentences, and no selling of a model that does not apply."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piezoid.verification.criteria import Verdict
from piezoid.verification.verification import Verification
from piezoid_reports.render import render
from piezoid_reports.score import line_rms_m, score_of
from piezoid_reports.traces import rms, traces_of
from piezoid_reports.weaknesses import weaknesses_of
from tests.reports.anatomy import Anatomy
from tests.reports.conftest import REASON
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import NOISE_m, axis_model, recording, stage_model


def _verdict(page: str) -> str:
    return next(e.text for e in Anatomy(page).all("p", "prose"))


def test_three_sentences_say_class_error_and_next_experiment(page: str) -> None:
    verdict = _verdict(page).replace("\u202f", " ")
    assert re.match(
        r"The hysteresis model applies to axes x and y\. On data of axis x it was not fitted to, "
        r"its worst axis, it misses the measured displacement by ",
        verdict,
    )
    assert "30.0 nm rms, 0.125 % of the 24.0 µm range" in verdict
    assert "own noise is 5.00 nm rms" in verdict
    assert "What weakens axis x most is an error 6.0 times the sensor noise; next, " in verdict
    assert len(re.findall(r"\.(?:\s|$)", verdict)) == 3


def test_causes_the_diagnosis_names_and_its_experiment_stand_in_the_third_sentence() -> None:
    found = diagnosed(finding("creep", rivals=("thermal_drift",)))
    page = render(stage_model(axis_model()), [recording()], diagnoses=(found,))
    verdict = _verdict(page).replace("\u202f", " ")
    said = (
        "in which the diagnosis finds creep (creep could be thermal drift); next, record another."
    )
    assert said in verdict
    assert len(re.findall(r"\.(?:\s|$)", verdict)) == 3


def test_an_axis_without_a_controller_is_named_on_top_beside_those_that_ship() -> None:
    page = render(
        stage_model(axis_model()), [recording()], unshipped={"z": "ceiling_A is missing"}
    )
    assert "axis x; axis z has no controller." in _verdict(page)
    assert Anatomy(page).all("p", "prose")[0].attributes["class"] == "prose bad"


def test_a_class_that_does_not_apply_is_said_on_top_in_words_and_colour(
    page_of_wrong_class: str,
) -> None:
    anatomy = Anatomy(page_of_wrong_class)
    assert len(anatomy.all("p", "alarm")) == 1
    assert anatomy.all("p", "prose")[0].attributes["class"] == "prose bad"
    verdict = _verdict(page_of_wrong_class)
    assert verdict.startswith(f"The hysteresis model does not apply to axis x (axis x: {REASON})")
    assert "Do not build a controller on it" in verdict


def test_a_class_that_does_not_apply_gets_no_score_and_no_certificate(
    page_of_wrong_class: str,
) -> None:
    anatomy = Anatomy(page_of_wrong_class)
    assert [e.text.strip() for e in anatomy.all("p", "score")] == ["does not apply"]
    certificate = page_of_wrong_class.partition('id="certificate"')[2].partition("</section>")[0]
    assert "no certificate" in certificate
    assert "with 95 % confidence" not in certificate


def test_a_good_page_raises_no_alarm(page: str) -> None:
    assert not Anatomy(page).all("p", "alarm")


def test_one_axis_that_fails_does_not_hide_behind_one_that_does_not() -> None:
    model = stage_model(axis_model("x"), axis_model("y", ("up.csv",), reason=REASON))
    page = render(model, [recording(), recording("up.csv", "y")])
    assert "does not apply to axis y, though it does to axis x" in _verdict(page)
    assert len(Anatomy(page).all("p", "alarm")) == 1


def test_the_score_is_hundred_at_the_noise_and_zero_at_the_line() -> None:
    axis = axis_model()
    traces = traces_of(axis, [recording()])
    for held_m, wanted in ((NOISE_m, 100), (line_rms_m(traces), 0), (1.0, 0)):
        quality = replace(axis.quality, held_out_rms_m=held_m)
        assert score_of(replace(axis, quality=quality), traces) == wanted


def test_the_residual_of_a_trace_is_the_noise_that_was_added() -> None:
    (trace,) = traces_of(axis_model(), [recording()])
    # 2900 counted rows: their rms is the noise's to 1.3 % (one sigma); 5 % is nearly four sigma.
    assert rms(trace.residual_m) == pytest.approx(NOISE_m, rel=0.05)
    assert np.isnan(trace.residual_m[1500:1600]).all()  # rows the fit left out
    assert np.isfinite(trace.residual_m[:1500]).all()


def test_line_and_model_are_judged_on_the_same_samples() -> None:
    (trace,) = traces_of(axis_model(), [recording()])
    np.testing.assert_array_equal(np.isnan(trace.line_m), np.isnan(trace.modelled_m))
    assert trace.counted == 2900
    # Least squares: what the common slope and the own zero leave is neither tilted nor shifted.
    there = np.isfinite(trace.line_m)
    left, drive = trace.line_residual_m[there], trace.voltage_V[there]
    assert abs(left.mean()) < 1e-12
    assert abs(np.sum(left * (drive - drive.mean()))) < 1e-12


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"held_out_kind": "second half"}, "second half"),
        ({"converged": False}, "limit of iterations"),
        ({"held_out_rms_m": 6e-9}, "this sensor sees no more"),
        ({"held_out_rms_m": 6e-8}, "12.0 times the sensor noise"),
    ],
)
def test_each_weakness_is_named_with_what_to_do(change: dict[str, object], said: str) -> None:
    axis = axis_model()
    changed = replace(axis, quality=replace(axis.quality, **change))
    found = [weakness for weakness in weaknesses_of(changed) if said in weakness.why]
    assert len(found) == 1
    assert found[0].remedy


def test_a_zero_that_wanders_is_a_weakness_with_its_size() -> None:
    assert any("moves by 200\u202fnm" in weakness.why for weakness in weaknesses_of(axis_model()))


def test_the_controller_that_ships_stands_in_the_first_sentence() -> None:
    passed = verification(value=0.2)
    failed = verification(value=0.9)
    model, recordings = stage_model(axis_model()), [recording()]
    good = _verdict(render(model, recordings, verification=passed))
    assert ", and the controller that ships passed all 1 verdicts. On data" in good
    page = render(model, recordings, verification=failed)
    assert "but the controller that ships failed 1 of 1 verdicts, tracking (spiral) first." in (
        _verdict(page)
    )
    assert Anatomy(page).all("p", "prose")[0].attributes["class"] == "prose bad"


def verification(*, value: float) -> Verification:
    return Verification(
        name="bench",
        methods={"x": "mpi"},
        radius_m=1e-6,
        comparison=(),
        spirals=(),
        currents=(),
        traces=(),
        verdicts=(Verdict(name="tracking", scenario="spiral", value=value, limit=0.5, unit="m"),),
        proofs=(),
        plants=(),
        parameters_digest="sha256:" + "0" * 64,
        runtime_digest="sha256:" + "0" * 64,
    )
