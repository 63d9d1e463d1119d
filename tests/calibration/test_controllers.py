"""Controllers of a calibration: what ships, what is refused, and the reasons."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from piezoid.calibration.controllers import Controllers, controllers_of
from piezoid.design.design import AxisDesign
from piezoid.design.design_stage import AxisDesignResult
from piezoid.errors import DesignError, RuntimeLibraryError, TemplateError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.identification.store import write_model
from piezoid.records.lab import Lab
from tests.design.designed import known_design
from tests.verification.known_fit import fitted

LAB = Lab(verification={"overshoot_percent": 5.0})
ADVICE = {"needed": "8 N", "remedy": "Push less."}
STEPS = ("design", "export", "verification")


@pytest.fixture
def design_x() -> AxisDesign:
    return known_design().axis("x")


def with_reference(design: AxisDesign, filter_: Sequence[float], **changes: float) -> AxisDesign:
    loop = design.recommended
    reference = replace(loop.reference, filter=np.array(filter_))
    return replace(design, loops=(replace(loop, reference=reference, **changes),))


def stage(first_axis: AxisModel, *further_axes: AxisModel) -> ActuatorModel:
    return replace(
        fitted(), axes={axis_model.axis: axis_model for axis_model in (first_axis, *further_axes)}
    )


def controllers(
    model: ActuatorModel,
    *outcomes: AxisDesignResult,
    fault: Exception | None = None,
    lab: Lab = LAB,
) -> Controllers:
    return controllers_of(
        model, write_model(model), lab, lambda _: None, outcomes=outcomes, fault=fault
    )


def test_a_failed_loop_with_damping_is_replaced_by_a_loop_below_the_mode(design_x):
    """The fast loop overshoots by 18 % instead of 5 %; the slow loop ships with a remark."""
    fast = with_reference(design_x, (9.0, -8.0), bandwidth_Hz=155.0)
    result = controllers(fitted(), AxisDesignResult(axis="x", design=fast, slower=design_x))
    assert result.shipped == {"x"}
    assert result.design is not None
    assert result.design.axes == (design_x,)
    (remark,) = result.design.remarks
    assert "a loop of 155 Hz that damps the mode did not pass" in remark
    assert "overshoot of axis x" in remark
    assert "This one of 90.0 Hz" in remark
    assert result.passed
    assert result.reason == ""
    assert not result.unshipped
    assert not any(name.startswith("refused/") for name in result.files)


def test_an_axis_that_does_not_ship_is_reported_and_the_others_ship(design_x):
    """Axis y moves against the direction of its design."""
    x = fitted()["x"]
    result = controllers(
        stage(x, replace(x, axis="y", polarity=-1)),
        AxisDesignResult(axis="x", design=design_x),
        AxisDesignResult(axis="y", design=replace(design_x, axis="y")),
    )
    assert result.shipped == {"x"}
    assert result.verification is not None
    assert result.verification.passed
    assert set(result.unshipped) == {"y"}
    assert "polarity is -1" in result.unshipped["y"]
    assert not result.passed


def test_a_missing_declaration_is_no_failure_but_an_infeasible_limit_is():
    unknown = AxisDesignResult(axis="x", obstacle=DesignError("no pole is declared", **ADVICE))
    missed = AxisDesignResult(axis="x", refusal=TemplateError("missed by 3 dB", **ADVICE))
    assert controllers(fitted(), unknown).passed
    assert not controllers(fitted(), missed).passed
    assert not controllers(fitted(), unknown, missed).passed


@pytest.mark.parametrize("kind", [DesignError, RuntimeLibraryError])
def test_a_refused_design_states_its_reason(kind):
    result = controllers(fitted(), fault=kind("9 N", **ADVICE))
    assert result.reason == "9 N. Needed: 8 N. Push less."
    assert not result.has_crashed
    assert (result.design, result.parameters, result.verification) == (None, None, None)


@pytest.mark.parametrize(
    ("polarity", "lab", "reason"),
    [
        (-1, LAB, "polarity is -1. Needed: a design for the direction"),
        (
            1,
            Lab(verification={"overshot": 5.0}),
            "unknown field `overshot`. Needed: numbers above zero",
        ),
    ],
    ids=STEPS[1:],
)
def test_a_refusal_after_the_design_keeps_the_design(polarity, lab, reason, design_x):
    axis = replace(fitted()["x"], polarity=polarity)
    result = controllers(stage(axis), AxisDesignResult(axis="x", design=design_x), lab=lab)
    assert reason in result.reason
    assert result.refused
    assert not result.has_crashed
    assert result.design is not None
    assert (result.parameters, result.verification) == (None, None)


@pytest.mark.parametrize("step", STEPS)
def test_an_internal_error_is_named_and_nothing_ships(step, design_x):
    """An empty filter breaks the export, and unknown parameters break the verification."""
    axis = fitted()["x"]
    unknown = replace(axis.uncertainty, names=tuple("abcdefghijkl"))
    model = stage(replace(axis, uncertainty=unknown) if step == "verification" else axis)
    design = with_reference(design_x, (0.0,)) if step == "export" else design_x
    fault = ValueError("40 states") if step == "design" else None
    result = controllers(model, AxisDesignResult(axis="x", design=design), fault=fault)
    assert result.reason.startswith("internal error (")
    assert (result.reason == "internal error (ValueError: 40 states)") == (step == "design")
    assert result.has_crashed
    assert not result.passed
    assert (result.parameters, result.verification) == (None, None)
    assert (result.design is None) == (step == "design")
