"""Summary of the report: verdict, error, limits, next step, and a card for each axis."""

from dataclasses import replace

import pytest

from piezoid.identification.quality import Limit
from tests.calibration.test_stage_statements import verification
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model

REASON = "sweep.csv: the loop opens the wrong way by 3.1 % of the range"


def sentences(page: str) -> dict[str, str]:
    """Return the sentences of the summary by their first words."""
    anatomy = Anatomy(page)
    words = [e.text for e in anatomy.all("b") if "span" in e.ancestors]
    texts = [e.text.replace("\u202f", " ") for e in anatomy.all("span", "sentence")]
    return dict(zip(words, texts, strict=True))


def tone(page: str) -> str:
    return Anatomy(page).all("p", "headline")[0].attributes["class"].split()[-1]


def test_a_good_stage_has_the_error_of_its_worst_axis(page):
    top = sentences(page)
    assert list(top) == ["Good", "Error"]
    assert "30.0 nm rms on axis x" in top["Error"]
    assert "0.125 % of the 24.0 µm range" in top["Error"]
    assert tone(page) == "good"
    assert not Anatomy(page).all("p", "alarm")


def test_the_summary_has_the_main_limit_and_the_next_step():
    diagnosis = diagnosed(
        finding("creep", rivals=("thermal_drift",), experiment="Do this at once.")
    )
    axis = axis_model()
    axis_of_few_blocks = replace(axis, uncertainty=replace(axis.uncertainty, blocks=5))
    page = page_of(axis_of_few_blocks, diagnoses=(diagnosis,))
    top = sentences(page)
    assert top["Next"].endswith("Do this at once.")
    assert "5 blocks" in top["Limits"]
    assert page.count("Do this at once.") == 1


def test_the_summary_states_the_worst_axis():
    axis_x, axis_y = axis_model("x"), axis_model("y", ("up.csv",))
    quality = replace(axis_y.quality, held_out_rms_m=4 * axis_y.quality.held_out_rms_m)
    axis_y = replace(axis_y, quality=quality)
    page = page_of(axis_x, axis_y)
    assert "120 nm rms on axis y" in sentences(page)["Error"]
    page = page_of(axis_model("x"), axis_model("y", ("up.csv",), reason=REASON))
    assert "does not apply to axis y, but it does to axis x" in sentences(page)["Rejected"]
    assert [e.text for e in Anatomy(page).all("span", "word")] == ["good", "model does not apply"]


def test_an_inapplicable_model_class_is_rejected_in_word_and_colour():
    page = page_of(axis_model(reason=REASON))
    top = sentences(page)
    assert "Rejected" in top
    assert REASON in top["Next"]
    assert tone(page) == "bad"
    anatomy = Anatomy(page)
    assert len(anatomy.all("p", "alarm")) == 1
    assert [e.text for e in anatomy.all("span", "word")] == ["model does not apply"]


@pytest.mark.parametrize(
    ("score", "word"), [(20, "Poor"), (50, "Usable with care"), (85, "Usable with care")]
)
def test_open_loops_in_the_recordings_lower_the_grade(score, word):
    axis = axis_model()
    limit = Limit(lack="branch", reason="only one branch was recorded", most=score)
    axis = replace(axis, quality=replace(axis.quality, limits=(limit,)))
    top = sentences(page_of(axis))
    assert next(iter(top)) == word
    assert top["Reason"].startswith("Only one branch was recorded.")


@pytest.mark.parametrize(("value", "expected"), [(0.2, "good"), (0.9, "bad")])
def test_the_verification_decides_the_tone(value, expected):
    page = page_of(axis_model(), verification=verification(value=value))
    assert tone(page) == expected
    top = sentences(page)
    if expected == "good":
        assert "passed all 1 check" in top["Good"]
    else:
        assert "failed 1 of 1 check" in top["Fails"]
        assert "model good" in top["Fails"]


def test_the_summary_names_an_axis_without_a_controller():
    page = page_of(axis_model(), unshipped={"z": "ceiling_A is missing"})
    assert "axis z has no controller" in sentences(page)["Fails"]
    assert tone(page) == "bad"
    assert page.count("ceiling_A is missing") == 1
