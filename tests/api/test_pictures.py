"""Every record draws itself into axes of its own or given ones, with a unit at each number."""

import re
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import piezoid
from piezoid.errors import PictureError
from tests.api.stage import fitted, recorded, unseen_drive
from tests.reports.known_diagnosis import diagnosed, finding
from tests.verification.known_fit import fitted as known
from tests.verification.rig import RATE_Hz

mpl.use("Agg")

HAS_UNIT = re.compile(r"\((V|s|Hz|1|dB|[pnµm]?m(/V)?)\)$")


@pytest.fixture(scope="module")
def design() -> piezoid.Design:
    return piezoid.design(known(), sampling_rate_Hz=RATE_Hz)


@pytest.fixture(scope="module")
def shipping(design) -> piezoid.Shipping:
    return piezoid.export(known(), design)


def drawn(axes) -> Figure:
    """Return the figure, drawn, with something in it and a unit at each axis of numbers."""
    axes.figure.canvas.draw()
    assert axes.has_data()
    for one in axes.figure.axes:
        for label in (one.get_xlabel(), one.get_ylabel()):
            assert not label or HAS_UNIT.search(label), label
    assert HAS_UNIT.search(axes.get_xlabel())
    return axes.figure


def test_a_recording_draws_its_loop_and_its_course() -> None:
    sweep, _ = fitted()
    loop = piezoid.plot(sweep)
    drawn(loop)
    assert loop.get_ylabel() == "displacement of x (µm)"
    (line,) = loop.lines
    assert np.allclose(line.get_ydata(), 1e6 * sweep.displacement_m())
    drawn(piezoid.plot(sweep, "time"))


def test_a_model_draws_its_loops_its_response_and_an_unseen_recording() -> None:
    _, model = fitted()
    loops = piezoid.plot(model)
    drawn(loops)
    assert len(loops.lines) == 3
    drawn(piezoid.plot(known(), "response"))
    unseen = recorded(unseen_drive(), 5, "unseen")
    beside = piezoid.plot(model, recording=unseen)
    assert [line.get_label() for line in beside.lines] == ["measured", "predicted"]
    drawn(beside)
    drawn(piezoid.plot(model, "error", recording=unseen))


def test_a_diagnosis_draws_what_was_found_and_what_was_not() -> None:
    known_one = diagnosed(finding("creep", share=2.5e-3))
    absent = tuple(one for one in known_one.not_detected if one.effect == "slew_limit")
    found = replace(known_one, stroke_m=1e-5, not_detected=absent)
    axes = piezoid.plot(found)
    drawn(axes)
    assert [tick.get_text() for tick in axes.get_yticklabels()] == ["creep", "slew limit"]
    (bar,) = axes.patches
    assert bar.get_x() + bar.get_width() == pytest.approx(25.0)  # nm: 0.25 % of 10 um


def test_a_design_draws_what_each_loop_leaves(design) -> None:
    axes = piezoid.plot(design)
    drawn(axes)
    drawn(piezoid.plot(design, axis="x"))
    with pytest.raises(PictureError, match="no axis 'q'"):
        piezoid.plot(design, axis="q")


def test_a_verification_draws_methods_and_verdicts(shipping) -> None:
    found = shipping.verification
    axes = piezoid.plot(found)
    drawn(axes)
    methods = {row.method for row in found.comparison}
    assert len(axes.lines) == len(methods)
    assert sum(line.get_label().endswith("ships") for line in axes.lines) == 1
    verdicts = piezoid.plot(found, "verdicts")
    drawn(verdicts)
    assert len(verdicts.patches) == sum(verdict.limit > 0.0 for verdict in found.verdicts)


def test_a_closed_loop_draws_reference_and_position(design) -> None:
    model = known()
    reference_m = model["x"].zero_m + 1e-7 * np.sin(np.linspace(0.0, 20.0, 2000))
    loop = piezoid.simulate_loop(model, reference_m, design)
    drawn(piezoid.plot(loop))
    drawn(piezoid.plot(loop, "error"))
    frame = loop.to_frame()
    assert np.array_equal(frame["error"], reference_m - frame["position"])
    assert loop.rms_error == pytest.approx(float(np.sqrt(np.mean(frame["error"] ** 2))))


def test_pictures_go_where_they_are_asked_to(design) -> None:
    sweep, model = fitted()
    figure = Figure()
    for record, place in zip((sweep, model, design), figure.subplots(3), strict=True):
        assert piezoid.plot(record, ax=place) is place
    figure.savefig("/dev/null", format="png")


def test_unknown_kinds_and_foreign_axes_are_refused() -> None:
    sweep, model = fitted()
    with pytest.raises(PictureError, match=r"kind 'spiral'\. Needed: one of loop, time"):
        piezoid.plot(sweep, "spiral")
    with pytest.raises(PictureError, match="ax is of type str"):
        piezoid.plot(model, ax="here")
