"""The verdict on top: what holds, limits and is next; no selling of what does not apply."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.effects import EFFECTS
from piezoid.formatting import words
from piezoid.identification.model import AxisModel
from piezoid.identification.quality import Limit
from piezoid.identification.quality import Verdict as ClassVerdict
from piezoid.verification.criteria import Verdict
from piezoid.verification.verification import Verification
from piezoid_reports.render import render
from piezoid_reports.sections.verdict import line_rms_m, score_of
from piezoid_reports.traces import rms, traces_of
from piezoid_reports.weaknesses import weaknesses_of
from piezoid_reports.what_is_left import left_of, shape_lacked
from tests.reports.anatomy import Anatomy
from tests.reports.conftest import REASON
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import NOISE_m, axis_model, recording, stage_model


def _verdict(page: str) -> str:
    """Return the sentences on top, without the words that say what each answers."""
    return " ".join(e.text for e in Anatomy(page).all("span", "sentence"))


def test_the_sentences_say_what_holds_what_limits_and_what_to_do_next(page: str) -> None:
    verdict = _verdict(page).replace("\u202f", " ")
    assert re.match(
        r"The hysteresis model applies to axes x and y\. On data it was not fitted to, the model "
        r"misses the measured displacement of axis x, its worst, by ",
        verdict,
    )
    assert "30.0 nm rms, 0.125 % of the 24.0 µm range" in verdict
    assert "own noise is 5.00 nm rms" in verdict
    assert "What weakens axis x most is an error 6.0 times the sensor noise." in verdict
    assert len(re.findall(r"\.(?:\s|$)", verdict)) == 4


def test_the_third_sentence_names_the_causes_and_the_experiment_for_what_is_in_doubt() -> None:
    found = diagnosed(
        finding("initial_state", experiment="Cycle the drive twice."),
        finding("creep", rivals=("thermal_drift",), experiment="Record a staircase. Mirror it."),
    )
    page = render(stage_model(axis_model()), [recording()], diagnoses=(found,))
    verdict = _verdict(page).replace("\u202f", " ")
    said = (
        "an error 6.0 times the sensor noise, with initial state and creep already taken out "
        "(creep could be thermal drift). Record a staircase."
    )
    assert said in verdict
    assert len(re.findall(r"\.(?:\s|$)", verdict)) == 4
    # While a cause is in doubt nobody says that no other is to be seen.
    assert "no other cause is visible" not in page


@pytest.mark.parametrize("effect", [effect.name for effect in EFFECTS])
def test_an_error_far_from_noise_is_met_by_the_experiment_of_the_cause_found(effect: str) -> None:
    found = diagnosed(finding(effect, experiment="Do this at once. Then that."))
    (weakness,) = [one for one in weaknesses_of(axis_model(), found) if "times" in one.what]
    assert words(effect) in weakness.what
    assert words(effect) in weakness.why
    assert weakness.remedy == "Do this at once. Then that."


def test_verdict_card_and_last_chapter_propose_one_and_the_same_experiment() -> None:
    found = diagnosed(finding("creep", experiment="Do this at once. Then that."))
    page = render(stage_model(axis_model()), [recording()], diagnoses=(found,))
    (card,) = Anatomy(page).all("article", "card")
    limits = page.partition('id="limits"')[2].partition("</section>")[0]
    assert ". Do this at once." in _verdict(page)
    assert "Do this at once. Then that." in card.text
    assert "Do this at once. Then that." in limits
    assert "three speeds" not in page


def test_a_diagnosis_that_finds_nothing_is_not_answered_by_what_it_has_already_tested() -> None:
    page = render(stage_model(axis_model()), [recording()], diagnoses=(diagnosed(),))
    assert "for which the diagnosis finds no cause. Record reversals" in _verdict(page)
    assert "three speeds" not in page


def moving(*zero_m: float) -> AxisModel:
    """Return an axis whose zeros went through these during every recording."""
    axis = axis_model()
    starts = tuple(replace(one, zero_m=np.array(zero_m)) for one in axis.starts)
    return replace(axis, starts=starts)


def test_an_error_that_a_wider_class_does_not_make_is_the_shape_of_the_loops() -> None:
    """Error 31.6 nm: a class that leaves less than 22.3 nm makes less than half of its power."""
    for wide_m, is_shape in ((8e-9, True), (30e-9, False)):
        found = replace(diagnosed(), envelope_rms_m=wide_m)
        found = replace(found, final=replace(found.final, rms_m=31.6e-9))
        page = render(stage_model(moving(0.0)), [recording()], diagnoses=(found,))
        assert ("which lies in the shape of its loops" in _verdict(page)) == is_shape
        assert ("finds no cause" in _verdict(page)) != is_shape
        assert ("the widest class of hysteresis leaves 8.00 nm" in page) == is_shape


def test_the_shape_of_the_loops_is_no_cause_where_the_recordings_could_not_tell_it() -> None:
    """A wide class imitates a lag at one speed, a zero that moves, and what a class refuses."""
    found = replace(diagnosed(), envelope_rms_m=8e-9)
    axis = moving(0.0)
    one_speed = Limit(lack="speed", reason="there is one speed", most=50)
    narrow = replace(axis, quality=replace(axis.quality, limits=(one_speed,)))
    refused = replace(axis, verdict=ClassVerdict(applies=False, reason="a butterfly"))
    assert shape_lacked(found, axis)
    # rms of a line 14 and 35 nm, of two lines to and fro as much
    assert shape_lacked(found, moving(0.0, 5e-8))
    assert shape_lacked(found, moving(0.0, 5e-8, 0.0))
    assert not shape_lacked(found, moving(0.0, 1.2e-7))
    assert not shape_lacked(found, moving(0.0, 1.2e-7, 0.0))
    assert not shape_lacked(found, narrow)
    assert not shape_lacked(found, refused)
    beside = replace(diagnosed(finding("creep")), envelope_rms_m=8e-9)
    assert "most of it lies in the shape" in left_of(beside, axis).short
    assert "the shape" not in left_of(beside, narrow).short


def test_a_cause_stands_on_the_card_beside_a_weakness_that_it_does_not_explain() -> None:
    axis = axis_model()
    near = replace(axis.quality, held_out_kind="second half", held_out_rms_m=3 * NOISE_m)
    axis = replace(axis, quality=near)
    found = diagnosed(finding("delay", experiment="Record a chirp."))
    page = render(stage_model(axis), [recording()], diagnoses=(found,))
    (card,) = Anatomy(page).all("article", "card")
    assert "Only one recording was given" in card.text
    assert "The diagnosis finds delay, and took it out." in card.text
    assert "Record a second, different drive" in _verdict(page)


def test_a_zero_that_moves_is_no_riddle_beside_the_drift_that_was_found() -> None:
    quality = replace(axis_model().quality, held_out_rms_m=6e-9)
    axis = replace(axis_model(), quality=quality)
    found = diagnosed(finding("thermal_drift", experiment="Hold it."))
    (weakness,) = [one for one in weaknesses_of(axis, found) if "zero" in one.what]
    assert "unexplained" not in weakness.what
    assert "thermal drift" in weakness.why
    assert weakness.remedy == "Hold it."


def test_the_third_sentence_is_about_the_axis_of_the_second() -> None:
    better, worse = axis_model("x"), axis_model("y", ("up.csv",))
    quality = replace(worse.quality, held_out_rms_m=4 * worse.quality.held_out_rms_m)
    worse = replace(worse, quality=quality)
    page = render(stage_model(better, worse), [recording(), recording("up.csv", "y")])
    assert "misses the measured displacement of axis y, its worst, by" in _verdict(page)
    assert "What weakens axis y most" in _verdict(page)


def test_an_axis_without_a_controller_is_named_on_top_beside_those_that_ship() -> None:
    page = render(
        stage_model(axis_model()), [recording()], unshipped={"z": "ceiling_A is missing"}
    )
    assert "axis x; axis z has no controller." in _verdict(page)
    assert Anatomy(page).all("p", "prose")[0].attributes["class"] == "prose said bad"


def test_a_class_that_does_not_apply_is_said_on_top_in_words_and_colour(
    page_of_wrong_class: str,
) -> None:
    anatomy = Anatomy(page_of_wrong_class)
    assert len(anatomy.all("p", "alarm")) == 1
    assert anatomy.all("p", "prose")[0].attributes["class"] == "prose said bad"
    verdict = _verdict(page_of_wrong_class)
    assert verdict.startswith(f"The hysteresis model does not apply to axis x (axis x: {REASON})")
    assert "Do not build a controller on it" in verdict


def test_a_class_that_does_not_apply_gets_no_score_and_no_certificate(
    page_of_wrong_class: str,
) -> None:
    anatomy = Anatomy(page_of_wrong_class)
    assert [e.text.strip() for e in anatomy.all("p", "score")] == ["✕ does not apply"]
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


def test_the_score_is_hundred_at_the_noise_and_holds_what_is_left_against_it() -> None:
    axis = axis_model()
    traces = traces_of(axis, [recording()])
    held_wanted = ((NOISE_m, 100), (2 * NOISE_m, 95), (4 * NOISE_m, 90), (8 * NOISE_m, 90))
    for held_m, wanted in (*held_wanted, (line_rms_m(traces), 0), (1.0, 0)):
        quality = replace(axis.quality, held_out_rms_m=held_m)
        assert score_of(replace(axis, quality=quality), traces) == wanted
    half_m = 0.5 * line_rms_m(traces)
    unknown = replace(axis.quality, held_out_rms_m=half_m, noise_rms_m=half_m, noise_is_most=True)
    assert score_of(replace(axis, quality=unknown), traces) == 50


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
        ({"held_out_kind": "second half"}, "parts of it that were left out"),
        ({"converged": False}, "limit of iterations"),
        ({"held_out_rms_m": 5.5e-9}, "1.1 times the sensor noise: this sensor sees no more"),
        ({"held_out_rms_m": 9.8e-9}, "2.0 times the sensor noise"),
        ({"held_out_rms_m": 6e-8}, "12.0 times the sensor noise"),
    ],
)
def test_each_weakness_is_named_with_what_to_do(change: dict[str, object], said: str) -> None:
    axis = axis_model()
    changed = replace(axis, quality=replace(axis.quality, **change))
    found = [weakness for weakness in weaknesses_of(changed) if said in weakness.why]
    assert len(found) == 1
    assert found[0].remedy


def test_an_error_far_above_the_noise_is_graver_than_that_nothing_else_was_recorded() -> None:
    axis = axis_model()
    for times, first in ((3, "its only recording"), (6, "an error 6.0 times the sensor noise")):
        one = replace(axis.quality, held_out_kind="second half", held_out_rms_m=times * NOISE_m)
        assert first in weaknesses_of(replace(axis, quality=one))[0].what


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
    assert Anatomy(page).all("p", "prose")[0].attributes["class"] == "prose said bad"


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


@pytest.mark.parametrize(("most", "word"), [(20, "Open"), (50, "Open"), (70, "Good")])
def test_nothing_is_called_good_of_which_a_loop_or_its_cause_was_not_measured(
    most: int, word: str
) -> None:
    axis = axis_model()
    lack = Limit(lack="branch", reason="only one branch was recorded", most=most)
    axis = replace(axis, quality=replace(axis.quality, limits=(lack,)))
    page = render(stage_model(axis), [recording()])
    answers = [e for e in Anatomy(page).all("span", "answer")]
    assert answers[0].text.startswith(word)
    assert (
        f"as far as can be told, for only one branch was recorded (a score of at most {most})"
        in _verdict(page)
    )


def test_samples_left_out_cover_no_more_of_the_picture_than_they_are() -> None:
    """One in twenty is a row of ticks, not a bar from end to end."""
    lost = replace(recording(), bridged=tuple(range(0, 3000, 20)))
    page = render(stage_model(axis_model()), [lost])
    drawn = re.search(r'<path class="layer line missing"[^>]* d="([^"]+)"', page)
    ticks = [(int(x), int(w)) for x, w in re.findall(r"M(\d+),\d+l(\d+),0", drawn[1])]
    assert len(ticks) > 140
    assert sum(w for _, w in ticks) < 0.4 * (ticks[-1][0] - ticks[0][0])
    rules = page.partition("<style>")[2].partition("</style>")[0].split("}")
    rounded = " ".join(rule for rule in rules if "linecap: round" in rule)
    assert ".dots" in rounded
    assert ".missing" not in rounded
