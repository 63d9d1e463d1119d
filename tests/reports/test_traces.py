"""Traces: measurement and simulation on the same samples, and excluded rows."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piezoid.records.recording import Quantity
from piezoid_reports.page import Page, rms, traces_of
from piezoid_reports.render import render
from tests.reports.known_stage import NOISE_m, axis_model, recording, stage_model


def test_the_residual_of_a_trace_is_the_simulated_noise():
    (trace,) = traces_of(axis_model(), [recording()])
    # The rms of 2900 rows has a standard error of 1.3 %; 5 % is nearly four times that.
    assert rms(trace.residual_m) == pytest.approx(NOISE_m, rel=0.05)
    assert np.isnan(trace.residual_m[1500:1600]).all()  # rows the fit left out
    assert np.isfinite(trace.residual_m[:1500]).all()


def test_line_and_model_have_the_same_samples():
    (trace,) = traces_of(axis_model(), [recording()])
    np.testing.assert_array_equal(np.isnan(trace.line_m), np.isnan(trace.modelled_m))
    assert np.isfinite(trace.modelled_m).sum() == 2900
    # By least squares, the residual of the line has no offset and no slope.
    is_fitted = np.isfinite(trace.line_m)
    residual_m, drive_V = trace.line_residual_m[is_fitted], trace.voltage_V[is_fitted]
    assert abs(residual_m.mean()) < 1e-12
    assert abs(np.sum(residual_m * (drive_V - drive_V.mean()))) < 1e-12


def test_missing_samples_are_drawn_to_scale():
    """A missing sample in twenty gives separate ticks, not a continuous bar."""
    recording_with_gaps = replace(recording(), bridged=tuple(range(0, 3000, 20)))
    page = render(Page(model=stage_model(axis_model()), recordings=[recording_with_gaps]))
    path = re.search(r'<path class="layer line missing"[^>]* d="([^"]+)"', page)
    ticks = [(int(x), int(w)) for x, w in re.findall(r"M(\d+),\d+l(\d+),0", path[1])]
    assert len(ticks) > 140
    assert sum(w for _, w in ticks) < 0.4 * (ticks[-1][0] - ticks[0][0])
    rules = page.partition("<style>")[2].partition("</style>")[0].split("}")
    rounded = " ".join(rule for rule in rules if "linecap: round" in rule)
    assert ".dots" in rounded
    assert ".missing" not in rounded


def test_a_recording_over_a_small_part_of_the_drive_is_drawn_last():
    full_range = recording()
    small = replace(
        full_range,
        name="chirp.csv",
        channels=tuple(
            replace(c, values=5.0 + 0.02 * (c.values - 5.0))
            if c.quantity is Quantity.VOLTAGE
            else c
            for c in full_range.channels
        ),
    )
    axis = axis_model("x", ("sweep.csv", "chirp.csv"))
    traces = traces_of(axis, [small, full_range])
    assert rms(traces[1].residual_m) > rms(traces[0].residual_m)
    assert [trace.recording.name for trace in traces] == ["sweep.csv", "chirp.csv"]
