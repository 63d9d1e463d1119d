"""The first screen: verdict, error, limits and next step, and a card for each axis."""

from dataclasses import replace

import pytest

from piezoid.identification.quality import Limit
from tests.calibration.test_stage_statements import verification
from tests.reports.anatomy import Anatomy
from tests.reports.conftest import REASON
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model


def sentences(page: str) -> dict[str, str]:
    """Return the sentences on top by the word in front of each."""
    anatomy = Anatomy(page)
    words = [e.text for e in anatomy.all("b") if "span" in e.inside]
    texts = [e.text.replace("\u202f", " ") for e in anatomy.all("span", "sentence")]
    return dict(zip(words, texts, strict=True))


def tone(page: str) -> str:
    return Anatomy(page).all("p", "headline")[0].attributes["class"].split()[-1]


def test_a_good_stage_is_called_good_with_the_error_of_its_worst_axis(page: str) -> None:
    top = sentences(page)
    assert list(top) == ["Good", "Error"]
    assert "30.0 nm rms on axis x" in top["Error"]
    assert "0.125 % of the 24.0 µm range" in top["Error"]
    assert tone(page) == "good"
    assert not Anatomy(page).all("p", "alarm")


def test_the_most_important_limit_and_the_next_step_stand_on_top() -> None:
    found = diagnosed(finding("creep", rivals=("thermal_drift",), experiment="Do this at once."))
    axis = axis_model()
    few = replace(axis, uncertainty=replace(axis.uncertainty, blocks=5))
    page = page_of(few, diagnoses=(found,))
    top = sentences(page)
    assert top["Next"].endswith("Do this at once.")
    assert "5 blocks" in top["Limits"]
    assert page.count("Do this at once.") == 1


def test_the_error_is_that_of_the_worst_axis() -> None:
    better, worse = axis_model("x"), axis_model("y", ("up.csv",))
    quality = replace(worse.quality, held_out_rms_m=4 * worse.quality.held_out_rms_m)
    worse = replace(worse, quality=quality)
    page = page_of(better, worse)
    assert "120 nm rms on axis y" in sentences(page)["Error"]


def test_a_class_that_does_not_apply_is_bad_in_word_and_colour(page_of_wrong_class: str) -> None:
    top = sentences(page_of_wrong_class)
    assert "Rejected" in top
    assert REASON in top["Next"]
    assert tone(page_of_wrong_class) == "bad"
    anatomy = Anatomy(page_of_wrong_class)
    assert len(anatomy.all("p", "alarm")) == 1
    assert [e.text for e in anatomy.all("span", "word")] == ["model does not apply"]


def test_one_axis_that_fails_does_not_hide_behind_one_that_does_not() -> None:
    page = page_of(axis_model("x"), axis_model("y", ("up.csv",), reason=REASON))
    assert "does not apply to axis y, but it does to axis x" in sentences(page)["Rejected"]
    assert [e.text for e in Anatomy(page).all("span", "word")] == ["good", "model does not apply"]


@pytest.mark.parametrize(("score", "word"), [(20, "Poor"), (50, "Usable"), (85, "Usable")])
def test_nothing_is_called_good_if_its_recordings_leave_the_loop_open(
    score: int, word: str
) -> None:
    axis = axis_model()
    limit = Limit(lack="branch", reason="only one branch was recorded", most=score)
    axis = replace(axis, quality=replace(axis.quality, limits=(limit,)))
    assert next(iter(sentences(page_of(axis)))) == word


@pytest.mark.parametrize(("value", "expected"), [(0.2, "good"), (0.9, "bad")])
def test_the_verification_decides_the_tone(value: float, expected: str) -> None:
    page = page_of(axis_model(), verification=verification(value=value))
    assert tone(page) == expected
    top = sentences(page)
    if expected == "good":
        assert "passed all 1 check" in top["Good"]
    else:
        assert "failed 1 of 1 check" in top["Fails"]
        assert "model good" in top["Fails"]


def test_an_axis_without_a_controller_is_named_on_top() -> None:
    page = page_of(axis_model(), unshipped={"z": "ceiling_A is missing"})
    assert "axis z has no controller" in sentences(page)["Fails"]
    assert tone(page) == "bad"
    assert page.count("ceiling_A is missing") == 1
