"""The error budget: one waterfall for each axis, from the plain simulation to the noise."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid_reports.page import Page
from piezoid_reports.parts import Waterfall
from piezoid_reports.sections import error_budget
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model


def waterfall(*effects: str) -> Waterfall:
    found = diagnosed(*map(finding, effects))
    page = Page(model=stage_model(axis_model()), diagnoses=(found,))
    section = error_budget.render(page)
    assert section is not None
    (picture,) = section.parts
    assert isinstance(picture, Waterfall)
    return picture


def test_each_bar_begins_where_the_one_before_ended_and_the_last_is_the_noise() -> None:
    total, *parts, noise = waterfall("creep").bars
    known = diagnosed(finding("creep"))
    assert total.end_m == known.baseline.rms_m
    assert noise.end_m == pytest.approx(known.noise_floor_rms_m)
    ends = [total.end_m, *(bar.start_m for bar in parts)]
    assert [bar.end_m for bar in parts] == pytest.approx(ends[:-1])
    sizes = [np.sqrt(bar.end_m**2 - bar.start_m**2) for bar in parts]
    shown = [p.rms_m for p in known.budget if p.part != "noise" and p.rms_m > 0.04 * total.end_m]
    assert sizes == pytest.approx(shown)


def test_a_diagnosis_without_a_budget_has_no_section() -> None:
    old = replace(diagnosed(), budget=())
    page = Page(model=stage_model(axis_model()), diagnoses=(old,))
    assert error_budget.render(page) is None
