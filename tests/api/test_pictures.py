"""Plots of every record, in new or given axes, with units."""

import re
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import piezoid
from piezoid.errors import PictureError
from tests.api.stage import fitted, recorded, unseen_drive
from tests.design.designed import known_design, known_shipping
from tests.reports.known_diagnosis import diagnosed, finding
from tests.verification.known_fit import fitted as known_model

mpl.use("Agg")

HAS_UNIT = re.compile(r"\((V|s|Hz|1|dB|[pnµm]?m(/V)?)\)$")


def draw(axes) -> Figure:
    """Draw the figure and check that it has data and units at its axes."""
    axes.figure.canvas.draw()
    assert axes.has_data()
    for panel in axes.figure.axes:
        for label in (panel.get_xlabel(), panel.get_ylabel()):
            assert not label or HAS_UNIT.search(label), label
    assert HAS_UNIT.search(axes.get_xlabel())
    return axes.figure


def test_a_recording_draws_its_loop_and_its_time_series():
    sweep, _ = fitted()
    loop = piezoid.plot(sweep)
    draw(loop)
    assert loop.get_ylabel() == "displacement of x (µm)"
    (line,) = loop.lines
    assert np.allclose(line.get_ydata(), 1e6 * sweep.displacement_m())
    draw(piezoid.plot(sweep, "time"))


def test_a_model_draws_its_loops_its_response_and_an_unseen_recording():
    _, model = fitted()
    loops = piezoid.plot(model)
    draw(loops)
    assert len(loops.lines) == 3
    draw(piezoid.plot(known_model(), "response"))
    unseen = recorded(unseen_drive(), 5, "unseen")
    prediction = piezoid.plot(model, recording=unseen)
    assert [line.get_label() for line in prediction.lines] == ["measured", "predicted"]
    draw(prediction)
    draw(piezoid.plot(model, "error", recording=unseen))


def test_a_diagnosis_draws_findings_and_detection_limits():
    diagnosis = diagnosed(finding("creep", share=2.5e-3))
    absent = tuple(effect for effect in diagnosis.not_detected if effect.effect == "slew_limit")
    reduced = replace(diagnosis, stroke_m=1e-5, not_detected=absent)
    axes = piezoid.plot(reduced)
    draw(axes)
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["creep", "slew limit"]
    (bar,) = axes.patches
    assert bar.get_x() + bar.get_width() == pytest.approx(25.0)  # nm: 0.25 % of 10 um


def test_a_design_draws_its_loops():
    design = known_design()
    axes = piezoid.plot(design)
    draw(axes)
    draw(piezoid.plot(design, axis="x"))
    with pytest.raises(PictureError, match="no axis 'q'"):
        piezoid.plot(design, axis="q")


def test_a_verification_draws_methods_and_verdicts():
    verification = known_shipping().verification
    axes = piezoid.plot(verification)
    draw(axes)
    methods = {row.method for row in verification.comparison}
    assert len(axes.lines) == len(methods)
    assert sum(line.get_label().endswith("ships") for line in axes.lines) == 1
    verdicts = piezoid.plot(verification, "verdicts")
    draw(verdicts)
    assert len(verdicts.patches) == sum(verdict.limit > 0.0 for verdict in verification.verdicts)


def test_a_closed_loop_draws_reference_and_position():
    model = known_model()
    reference_m = model["x"].zero_m + 1e-7 * np.sin(np.linspace(0.0, 20.0, 2000))
    loop = piezoid.simulate_loop(model, reference_m, known_design())
    draw(piezoid.plot(loop))
    draw(piezoid.plot(loop, "error"))
    frame = loop.to_frame()
    assert np.array_equal(frame["error"], reference_m - frame["position"])
    assert loop.rms_error == pytest.approx(float(np.sqrt(np.mean(frame["error"] ** 2))))


def test_a_plot_uses_the_given_axes():
    sweep, model = fitted()
    figure = Figure()
    for record, panel in zip((sweep, model, known_design()), figure.subplots(3), strict=True):
        assert piezoid.plot(record, ax=panel) is panel
    figure.savefig("/dev/null", format="png")


def test_unknown_kinds_and_foreign_axes_are_refused():
    sweep, model = fitted()
    with pytest.raises(PictureError, match=r"kind 'spiral'\. Needed: one of loop, time"):
        piezoid.plot(sweep, "spiral")
    with pytest.raises(PictureError, match="ax is of type str"):
        piezoid.plot(model, ax="here")
