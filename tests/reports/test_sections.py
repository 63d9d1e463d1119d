"""Every file of a chapter stands in the one visible tuple, and nothing else does."""

from importlib import import_module
from pathlib import Path

import piezoid_reports.sections
from piezoid_reports.page import Page
from piezoid_reports.render import render
from piezoid_reports.sections import (
    SECTIONS,
    coupling,
    design,
    diagnosis,
    dynamics,
    since,
    tunnelling,
    tunnelling_loop,
    verification,
)
from piezoid_reports.traces import all_traces
from tests.reports.anatomy import Anatomy
from tests.reports.known_stage import axis_model, recording, stage_model


def test_every_chapter_of_the_folder_is_in_the_tuple_once() -> None:
    folder = Path(piezoid_reports.sections.__file__).parent
    names = {p.stem for p in folder.glob("*.py")} - {"__init__"}
    files = {import_module(f"piezoid_reports.sections.{name}").render for name in names}
    assert set(SECTIONS) == files
    assert len(SECTIONS) == len(files)


def test_a_model_without_its_recordings_still_makes_a_page() -> None:
    page = Anatomy(render(stage_model(axis_model()), []))
    assert [e.attributes["id"] for e in page.all("section")][:3] == [
        "verdict",
        "measures",
        "loading-curve",
    ]
    assert not [e for e in page.all("caption") if "residual of each" in e.text]


def test_parameters_show_their_interval_their_bound_and_their_gauge() -> None:
    model = stage_model(axis_model())
    rows = _rows(render(model, [recording()]))
    # 1 % standard error times Student's 2.069 at 23 degrees of freedom.
    assert ("1", "(800 ± 17) mV", "(400.0 ± 8.3) nm/V", "") in rows
    assert (
        "2",
        "(2.100 ± 0.043) V",
        "(500 ± 10) nm/V",
        "on its bound 0; below 30.0 nm/V (95 %)",
    ) in rows
    assert ("1", "0 m (fixed)", "(1.000 ± 0.021)", "by the gauge") in [
        (a, b, f"({c})", d) for a, b, c, d in (r for r in rows if len(r) == 4)
    ]


def _rows(page: str) -> list[tuple[str, ...]]:
    rows: list[list[str]] = []
    for e in Anatomy(page).elements:
        if e.tag == "tr":
            rows.append([])
        elif e.tag in ("th", "td"):
            rows[-1].append(e.text.replace("\u202f", " "))
    return [tuple(row) for row in rows]


def test_every_order_that_was_tried_is_listed_and_the_least_is_marked() -> None:
    rows = _rows(render(stage_model(axis_model()), [recording()]))
    assert ("2", "2", "0", "delay", "30.0 nm", "0.125 %", "least") in rows
    assert ("1", "0", "0", "delay", "90.0 nm", "0.375 %", "") in rows


def test_the_certificate_states_its_conditions() -> None:
    page = render(stage_model(axis_model()), [recording()]).replace("\u202f", " ")
    assert (
        "with 95 % confidence the model is within 140 nm (0.583 % of the range) of a stage of "
        "this class, for every drive between 0 V and 10.0 V that changes no faster than 40.0 V/s"
    ) in page


ABOUT_MORE_THAN_AXES = {
    since.render,
    coupling.render,
    dynamics.render,
    tunnelling.render,
    tunnelling_loop.render,
    verification.render,
    design.render,
    diagnosis.render,
}


def test_chapters_are_given_records_and_nothing_is_computed_twice() -> None:
    model, given = stage_model(axis_model()), (recording(),)
    page = Page(
        model=model, recordings=given, traces=all_traces(model, given), model_digest="sha256:0"
    )
    for make in SECTIONS:
        section = make(page)
        assert (section is None) == (make in ABOUT_MORE_THAN_AXES)
        if section is None:
            continue
        assert section.anchor.replace("-", "").isalpha()
