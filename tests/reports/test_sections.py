"""Sections of the report: registration, intervals, limits, error budget."""

from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import piezoid_reports.sections
from piezoid.calibration.stage_statements import stage_statements
from piezoid.statement import select
from piezoid_reports.page import Page
from piezoid_reports.parts import Waterfall
from piezoid_reports.sections import SECTIONS, error_budget
from tests.reports.anatomy import Anatomy
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, recording, stage_model


def test_every_section_file_is_registered_once():
    folder = Path(piezoid_reports.sections.__file__).parent
    names = {p.stem for p in folder.glob("*.py")} - {"__init__"}
    files = {import_module(f"piezoid_reports.sections.{name}").render for name in names}
    assert set(SECTIONS) == files
    assert len(SECTIONS) == len(files)


def test_a_model_without_recordings_makes_a_page():
    page = Anatomy(page_of(axis_model(), recordings=()))
    assert [e.attributes["id"] for e in page.all("section")] == [
        "summary",
        "parameters",
        "limits",
        "provenance",
    ]


def rows(page: str) -> list[tuple[str, ...]]:
    cells: list[list[str]] = []
    for e in Anatomy(page).elements:
        if e.tag == "tr":
            cells.append([])
        elif e.tag in ("th", "td"):
            cells[-1].append(e.text.replace("\u202f", " "))
    return [tuple(row) for row in cells]


def test_quantities_of_the_fit_have_intervals_and_errors_their_rows():
    table = rows(page_of(axis_model()))
    assert ("width of the full loop", "(1.600 ± 0.040) µm") in table
    assert ("valid drive", "0 V to 10.0 V") in table
    page = page_of(axis_model())
    values = {row[0]: row[1] for row in rows(page) if len(row) == 2}
    assert values["held-out error, rms"] == "30.0 nm"
    assert values["bound of the hysteresis model alone, 95 %"] == "140 nm"
    assert values["guaranteed error with feedback"] == "none"
    assert "drive below 0 V or above 10.0 V" in page.replace("\u202f", " ")
    rejected = page_of(axis_model(reason="a butterfly"))
    assert "hysteresis model alone" not in rejected


def test_limits_contain_every_statement_outside_the_summary():
    axis = axis_model()
    limited = replace(
        axis,
        quality=replace(axis.quality, converged=False),
        uncertainty=replace(axis.uncertainty, blocks=5),
    )
    page = page_of(limited)
    limits = page.partition('id="limits"')[2].partition("</section>")[0]
    facts = select(stage_statements(stage_model(limited), recordings=[recording()]))
    for fact in facts:
        assert page.count(fact.text) == 1, fact
    assert sum(fact.text in limits for fact in facts) == len(facts) - 1


def test_a_limit_of_several_axes_has_a_single_row():
    unconverged = [
        replace(axis, quality=replace(axis.quality, converged=False))
        for axis in (axis_model("x"), axis_model("y", ("up.csv",)))
    ]
    limited = [replace(a, uncertainty=replace(a.uncertainty, blocks=5)) for a in unconverged]
    page = page_of(*limited)
    limits = [row[2] for row in rows(page) if row[0] == "note"]
    assert sum(text.startswith("Axes x, y: The intervals rest") for text in limits) == 1
    assert not any(text.startswith("Axis y: The intervals rest") for text in limits)


def test_intervals_contradicted_by_the_held_out_error_are_not_printed():
    axis = axis_model()
    wide = replace(axis, uncertainty=replace(axis.uncertainty, loop_width_m=(5.1e-6, 7.2e-6)))
    page = page_of(wide)
    values = {row[0]: row[1] for row in rows(page) if len(row) == 2}
    assert values["width of the full loop"] == "5.10 µm (no usable interval)"
    assert values["predicted position at the end of the range, 95 %"] == "no usable interval"
    assert "± 7.2" not in page


def test_bars_of_a_budget_are_contiguous_and_end_with_the_noise():
    diagnosis = diagnosed(finding("creep"))
    page = Page(model=stage_model(axis_model()), diagnoses=(diagnosis,))
    section = error_budget.render(page)
    assert section is not None
    (chart,) = section.parts
    assert isinstance(chart, Waterfall)
    total, *bars, noise = chart.bars
    assert total.end_m == diagnosis.baseline.rms_m
    assert noise.end_m == pytest.approx(diagnosis.noise_floor_rms_m)
    end_m = [total.end_m, *(bar.start_m for bar in bars)]
    assert [bar.end_m for bar in bars] == pytest.approx(end_m[:-1])
    sizes_m = [np.sqrt(bar.end_m**2 - bar.start_m**2) for bar in bars]
    expected_m = [
        p.rms_m for p in diagnosis.budget if p.part != "noise" and p.rms_m > 0.04 * total.end_m
    ]
    assert sizes_m == pytest.approx(expected_m)


def test_a_diagnosis_without_a_budget_has_no_section():
    diagnosis = replace(diagnosed(), budget=())
    page = Page(model=stage_model(axis_model()), diagnoses=(diagnosis,))
    assert error_budget.render(page) is None
