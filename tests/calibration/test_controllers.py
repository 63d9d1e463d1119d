"""Whatever stands in the way of a controller, model and report do not get lost."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from piezoid.calibration.controllers import Controllers, controllers_of
from piezoid.design.design import AxisDesign
from piezoid.design.design_stage import AxisDesignResult, design_axes
from piezoid.errors import DesignError, PiezoidError, RuntimeLibraryError, TemplateError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.model import AxisModel
from piezoid.identification.store import write_model
from piezoid.records.lab import Lab
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

LAB = Lab(verification={"overshoot_percent": 5.0})
SAID = {"needed": "8 N", "remedy": "Push less."}
STEPS = ("design", "export", "verification")


@pytest.fixture(scope="module")
def good() -> AxisDesign:
    """A controller of axis x of the known stage."""
    (outcome,) = design_axes(fitted(), sampling_rate_Hz=RATE_Hz, forms=("inverse",))
    assert outcome.design is not None
    return outcome.design


def with_reference(design: AxisDesign, filter_: Sequence[float], **others: float) -> AxisDesign:
    loop = design.recommended
    reference = replace(loop.reference, filter=np.array(filter_))
    return replace(design, loops=(replace(loop, reference=reference, **others),))


def stage(axis: AxisModel, *more: AxisModel) -> ActuatorModel:
    return replace(fitted(), axes={held.axis: held for held in (axis, *more)})


def controllers(model: ActuatorModel, *outcomes: AxisDesignResult, lab: Lab = LAB) -> Controllers:
    return made_of(model, outcomes, lab=lab)


def made_of(
    model: ActuatorModel,
    outcomes: tuple[AxisDesignResult, ...] = (),
    fault: Exception | None = None,
    lab: Lab = LAB,
) -> Controllers:
    return controllers_of(
        model, write_model(model), lab, lambda _: None, outcomes=outcomes, fault=fault
    )


def test_a_loop_that_damps_a_mode_and_fails_is_tried_once_more_below_the_mode(
    good: AxisDesign,
) -> None:
    """The fast loop overshoots by 18 % where 5 % are allowed; the slow one ships and says why."""
    fast = with_reference(good, (9.0, -8.0), bandwidth_Hz=155.0)
    made = controllers(fitted(), AxisDesignResult(axis="x", design=fast, slower=good))
    assert made.shipped == {"x"}
    assert made.design is not None
    assert made.design.axes == (good,)
    (remark,) = made.design.remarks
    assert "a loop of 155 Hz that damps the mode did not pass" in remark
    assert "overshoot of axis x" in remark
    assert "This one of 90.0 Hz" in remark
    assert made.passed
    assert made.reason == ""
    assert not made.unshipped
    assert not any(name.startswith("refused/") for name in made.files)


def test_an_axis_that_does_not_ship_is_told_and_keeps_no_other_back(good: AxisDesign) -> None:
    """Axis y moves the other way than the plant that its controller was designed for."""
    x = fitted()["x"]
    made = controllers(
        stage(x, replace(x, axis="y", polarity=-1)),
        AxisDesignResult(axis="x", design=good),
        AxisDesignResult(axis="y", design=replace(good, axis="y")),
    )
    assert made.shipped == {"x"}
    assert made.verification is not None
    assert made.verification.passed
    assert set(made.unshipped) == {"y"}
    assert "polarity is -1" in made.unshipped["y"]
    assert not made.passed


def test_what_nobody_declared_is_no_failure_but_a_limit_nothing_meets_is() -> None:
    unknown = AxisDesignResult(axis="x", obstacle=DesignError("no pole is declared", **SAID))
    missed = AxisDesignResult(axis="x", refusal=TemplateError("missed by 3 dB", **SAID))
    assert controllers(fitted(), unknown).passed
    assert not controllers(fitted(), missed).passed
    assert not controllers(fitted(), unknown, missed).passed


@pytest.mark.parametrize("kind", [DesignError, RuntimeLibraryError])
def test_a_refusal_of_a_design_is_told_in_its_own_words(kind: type[PiezoidError]) -> None:
    made = made_of(fitted(), fault=kind("9 N", **SAID))
    assert made.reason == "9 N. Needed: 8 N. Push less."
    assert not made.has_crashed
    assert (made.design, made.parameters, made.verification) == (None, None, None)


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
def test_a_refusal_of_a_later_step_is_told_and_the_design_is_kept(
    polarity: int, lab: Lab, reason: str, good: AxisDesign
) -> None:
    axis = replace(fitted()["x"], polarity=polarity)
    made = controllers(stage(axis), AxisDesignResult(axis="x", design=good), lab=lab)
    assert reason in made.reason
    assert made.refused
    assert not made.has_crashed
    assert made.design is not None
    assert (made.parameters, made.verification) == (None, None)


@pytest.mark.parametrize("step", STEPS)
def test_an_internal_error_is_named_and_nothing_ships(step: str, good: AxisDesign) -> None:
    """No filter at all in front of a loop, and errors of numbers that the model has not."""
    axis = fitted()["x"]
    unknown = replace(axis.uncertainty, names=tuple("abcdefghijkl"))
    model = stage(replace(axis, uncertainty=unknown) if step == "verification" else axis)
    design = with_reference(good, (0.0,)) if step == "export" else good
    fault = ValueError("40 states") if step == "design" else None
    made = made_of(model, (AxisDesignResult(axis="x", design=design),), fault)
    assert made.reason.startswith("internal error (")
    assert (made.reason == "internal error (ValueError: 40 states)") == (step == "design")
    assert made.has_crashed
    assert not made.passed
    assert (made.parameters, made.verification) == (None, None)
    assert (made.design is None) == (step == "design")
