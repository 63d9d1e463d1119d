"""The error budget is a waterfall for each axis, from the simulation to the noise."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid_reports.page import Page
from piezoid_reports.parts import Waterfall
from piezoid_reports.sections import error_budget
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model


def waterfall(*effects: str) -> Waterfall:
    diagnosis = diagnosed(*map(finding, effects))
    page = Page(model=stage_model(axis_model()), diagnoses=(diagnosis,))
    section = error_budget.render(page)
    assert section is not None
    (chart,) = section.parts
    assert isinstance(chart, Waterfall)
    return chart


def test_bars_are_contiguous_and_end_with_the_noise():
    total, *bars, noise = waterfall("creep").bars
    diagnosis = diagnosed(finding("creep"))
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
