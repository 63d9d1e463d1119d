"""Traces: measurement and simulation on the same samples, and what the fit left out."""

import re
from dataclasses import replace

import numpy as np
import pytest

from piezoid.records.recording import Quantity
from piezoid_reports.page import Page, rms, traces_of
from piezoid_reports.render import render
from tests.reports.known_stage import NOISE_m, axis_model, recording, stage_model


def test_the_residual_of_a_trace_is_the_noise_that_was_added() -> None:
    (trace,) = traces_of(axis_model(), [recording()])
    # 2900 counted rows: their rms is the noise's to 1.3 % (one sigma); 5 % is nearly four sigma.
    assert rms(trace.residual_m) == pytest.approx(NOISE_m, rel=0.05)
    assert np.isnan(trace.residual_m[1500:1600]).all()  # rows the fit left out
    assert np.isfinite(trace.residual_m[:1500]).all()


def test_line_and_model_are_judged_on_the_same_samples() -> None:
    (trace,) = traces_of(axis_model(), [recording()])
    np.testing.assert_array_equal(np.isnan(trace.line_m), np.isnan(trace.modelled_m))
    assert np.isfinite(trace.modelled_m).sum() == 2900
    # Least squares: what the common slope and the own zero leave is neither tilted nor shifted.
    there = np.isfinite(trace.line_m)
    left, drive = trace.line_residual_m[there], trace.voltage_V[there]
    assert abs(left.mean()) < 1e-12
    assert abs(np.sum(left * (drive - drive.mean()))) < 1e-12


def test_samples_left_out_cover_no_more_of_the_picture_than_they_are() -> None:
    """One in twenty is a row of ticks, not a bar from end to end."""
    lost = replace(recording(), bridged=tuple(range(0, 3000, 20)))
    page = render(Page(model=stage_model(axis_model()), recordings=[lost]))
    drawn = re.search(r'<path class="layer line missing"[^>]* d="([^"]+)"', page)
    ticks = [(int(x), int(w)) for x, w in re.findall(r"M(\d+),\d+l(\d+),0", drawn[1])]
    assert len(ticks) > 140
    assert sum(w for _, w in ticks) < 0.4 * (ticks[-1][0] - ticks[0][0])
    rules = page.partition("<style>")[2].partition("</style>")[0].split("}")
    rounded = " ".join(rule for rule in rules if "linecap: round" in rule)
    assert ".dots" in rounded
    assert ".missing" not in rounded


def test_a_recording_over_a_small_part_of_the_drive_is_drawn_last() -> None:
    full = recording()
    small = replace(
        full,
        name="chirp.csv",
        channels=tuple(
            replace(c, values=5.0 + 0.02 * (c.values - 5.0))
            if c.quantity is Quantity.VOLTAGE
            else c
            for c in full.channels
        ),
    )
    axis = axis_model("x", ("sweep.csv", "chirp.csv"))
    traces = traces_of(axis, [small, full])
    assert rms(traces[1].residual_m) > rms(traces[0].residual_m)
    assert [trace.recording.name for trace in traces] == ["sweep.csv", "chirp.csv"]
