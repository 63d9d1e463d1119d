"""Two calibrations side by side: what is told as moved did move, and nothing else is."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.calibration.since import Known, Moved, Since, since
from piezoid.errors import ParameterFileError
from piezoid.identification.model import AxisModel
from tests.reports.known_diagnosis import diagnosed, finding
from tests.reports.known_stage import axis_model, stage_model


def moved_axis(sensitivity: float = 1.0, opening_m: float = 1.6e-6) -> AxisModel:
    """Return the known axis with another sensitivity and another opening of its loop."""
    axis = axis_model()
    known = axis.uncertainty
    return replace(
        axis,
        uncertainty=replace(
            known,
            loading_m=sensitivity * known.loading_m,
            loop_width_m=(opening_m, known.loop_width_m[1]),
        ),
    )


def compared(now: AxisModel, **named: object) -> Since:
    return since(
        stage_model(axis_model()),
        stage_model(now),
        then_digest="sha256:1",
        now_digest="sha256:2",
        **named,  # type: ignore[arg-type]
    )


def names(found: Since) -> set[str]:
    return {one.name for one in found.beyond}


def test_the_same_stage_has_moved_nowhere_and_its_curves_lie_on_each_other() -> None:
    found = compared(axis_model())
    assert names(found) == set()
    assert sum(one.is_known for one in found.moved) >= 3
    assert np.array_equal(found.curves[0].then_m, found.curves[0].now_m)


def test_a_sensitivity_beyond_both_intervals_moves_the_curve_and_nothing_else() -> None:
    # Each curve is known to 1 %: 1.5 % lies inside both intervals, 3 % outside.
    assert names(compared(moved_axis(1.015))) == set()
    found = compared(moved_axis(1.03))
    assert names(found) == {
        "displacement after a rise of 2.5 V",
        "displacement after a rise of 5 V",
    }
    assert [one.ratio for one in found.beyond] == pytest.approx([1.03, 1.03])


def test_a_wider_loop_is_told_by_its_opening() -> None:
    # Both are known to 40 nm.
    assert names(compared(moved_axis(opening_m=1.67e-6))) == set()
    assert names(compared(moved_axis(opening_m=1.69e-6))) == {"opening of the full loop"}


def test_a_turned_sign_of_the_drive_moves_the_curve() -> None:
    found = compared(replace(axis_model(), polarity=-1))
    assert {one.now.value < 0.0 < one.then.value for one in found.beyond} == {True}


def test_without_an_interval_nothing_is_judged() -> None:
    one = Moved(axis="x", name="n", unit="m", then=Known(value=1.0), now=Known(value=9.0))
    assert (one.is_known, one.is_moved) == (False, False)


def test_another_range_is_told_and_its_curves_are_not_compared() -> None:
    found = compared(replace(moved_axis(1.5), voltage_V=(0.0, 8.0)))
    assert found.curves == ()
    assert names(found) == set()
    assert found.notes == (
        "Axis x was driven over 0 to 10 V then and 0 to 8 V now: loops and loading curves of "
        "different ranges are not compared.",
    )


def test_causes_come_and_go() -> None:
    found = compared(
        axis_model(),
        diagnoses_then=(diagnosed(finding("creep"), finding("lag")),),
        diagnoses_now=(diagnosed(finding("creep"), finding("drift")),),
    )
    assert [one.effect for one in found.came] == ["drift"]
    assert [one.effect for one in found.went] == ["lag"]
    assert len(found.causes) == 3


def test_a_script_is_told_the_same() -> None:
    told = compared(moved_axis(1.03), unheld="there is no params.json in january.").summary()
    beyond = {one["name"] for one in told["moved"] if one["beyond_intervals"]}
    assert beyond == names(compared(moved_axis(1.03)))
    assert (told["then"], told["now"]) == ("sha256:1", "sha256:2")
    assert told["controller_holds"] is None
    assert told["controller_not_run"] == "there is no params.json in january."


def test_axes_of_one_calibration_alone_are_named_and_two_stages_are_refused() -> None:
    found = since(
        stage_model(axis_model("x"), axis_model("y")),
        stage_model(axis_model("x"), axis_model("z")),
        then_digest="",
        now_digest="",
    )
    assert (found.only_then, found.only_now) == (("y",), ("z",))
    with pytest.raises(ParameterFileError, match="older stage has axes y, this one x"):
        since(
            stage_model(axis_model("y")),
            stage_model(axis_model("x")),
            then_digest="",
            now_digest="",
        )
