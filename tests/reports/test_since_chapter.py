"""The chapter on what changed: what moved by name, the controller of then in one sentence."""

from dataclasses import replace

from piezoid.calibration.since import Since, since
from piezoid_reports.render import render
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, recording, stage_model


def found(sensitivity: float = 1.0) -> Since:
    axis = axis_model()
    known = replace(axis.uncertainty, loading_m=sensitivity * axis.uncertainty.loading_m)
    return since(
        stage_model(axis),
        stage_model(replace(axis, uncertainty=known)),
        then_digest="sha256:1",
        now_digest="sha256:2",
        diagnoses_then=(diagnosed(finding("creep")),),
        diagnoses_now=(diagnosed(finding("thermal_drift")),),
        unheld="there is no params.json in january.",
    )


def page(sensitivity: float = 1.0, *, compared: bool = True) -> Anatomy:
    given = found(sensitivity) if compared else None
    return Anatomy(render(stage_model(axis_model()), [recording()], since=given))


def texts(anatomy: Anatomy, tag: str, *classes: str) -> str:
    return " ".join(e.text for e in anatomy.all(tag, *classes)).replace("\u202f", " ")


def test_without_an_earlier_calibration_there_is_no_chapter() -> None:
    assert "since" not in {e.attributes.get("id") for e in page(compared=False).all("section")}


def test_the_first_screen_says_what_moved_what_came_and_whether_the_controller_holds() -> None:
    said = texts(page(1.03), "span", "sentence")
    assert "2 of 3 quantities moved beyond their intervals: axis x, displacement after" in said
    assert "(+3.00 %)" in said
    assert "New causes: thermal drift (axis x)." in said
    assert "No longer named: creep (axis x)." in said
    assert "was not run: there is no params.json in january." in said


def test_a_stage_that_stayed_is_told_in_as_few_words() -> None:
    assert "None of 3 quantities moved beyond its interval." in texts(page(), "span", "sentence")


def test_the_table_has_all_of_it_and_those_that_moved_first() -> None:
    rows = [e.text.replace("\u202f", " ") for e in page(1.03).all("tr")]
    marks = [row for row in rows if row.endswith(("moved", "within", "no interval"))]
    assert [row.endswith("moved") for row in marks[:3]] == [True, True, False]
    assert any("sensor noise, rms" in row and row.endswith("no interval") for row in marks)


def test_the_figure_shows_now_minus_then() -> None:
    titles = texts(page(1.03), "p", "figure-title")
    assert "Axis x: how far the same drive moves it now, and then" in titles
