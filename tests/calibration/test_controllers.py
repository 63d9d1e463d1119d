"""Whatever stands in the way of a controller, model and report do not get lost."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from piezoid.calibration.controllers import controllers_of
from piezoid.calibration.stage_jobs import Designed
from piezoid.design.stage import Outcome
from piezoid.errors import DesignError, PiezoidError, RuntimeLibraryError, TemplateError

PARAMETERS = SimpleNamespace(unshipped={})
STEPS = {
    "piezoid.design.stage.design_of": SimpleNamespace(
        to_json=lambda: b'{"digest": "d"}', refused={}
    ),
    "piezoid.export.stage.export_stage": PARAMETERS,
    "piezoid.verification.shipping.shipping_of": SimpleNamespace(
        parameters=PARAMETERS,
        verification=SimpleNamespace(passed=True),
        refused=None,
        refused_verification=None,
        reasons={},
    ),
}


@dataclass(frozen=True)
class Loop:
    """An axis whose loop has a bandwidth."""

    bandwidth_Hz: float
    axis: str = "x"

    @property
    def recommended(self) -> "Loop":
        return self


def test_a_loop_that_damps_a_mode_and_fails_is_tried_once_more_below_the_mode(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The fast loop fails its verification, the slow one ships and says why."""
    fast, slow = Loop(155.0), Loop(26.0)

    @dataclass(frozen=True)
    class Found:
        axes: tuple[Loop, ...]
        remarks: tuple[str, ...] = ()

        def axis(self, _: str) -> Loop:
            return self.axes[0]

        def to_json(self) -> bytes:
            return b'{"digest": "d"}'

    def design_of(outcomes: Any, **_: Any) -> Any:
        return Found(axes=tuple(one.design for one in outcomes))

    def export_stage(_: Any, design: Any, **__: Any) -> Any:
        return SimpleNamespace(axes=design.axes, unshipped={})

    def shipping_of(parameters: Any, *_: Any, **__: Any) -> Any:
        passes = parameters.axes == (slow,)
        return SimpleNamespace(
            parameters=parameters if passes else None,
            verification=SimpleNamespace(passed=passes),
            refused=None,
            refused_verification=None,
            reasons={} if passes else {"x": "135 % overshoot"},
        )

    for name, step in {
        "piezoid.design.stage.design_of": design_of,
        "piezoid.export.stage.export_stage": export_stage,
        "piezoid.verification.shipping.shipping_of": shipping_of,
    }.items():
        module, _, function = name.rpartition(".")
        monkeypatch.setattr(import_module(module), function, step)
    raised = Outcome(axis="x", design=fast, slower=slow)  # type: ignore[arg-type]
    found = controllers_of(
        SimpleNamespace(coupled=None),  # type: ignore[arg-type]
        b'{"digest": "m"}',
        None,
        lambda _: None,
        designed=(Designed(outcomes=(raised,)),),
    )
    assert found.shipped == {"x"}
    assert found.design.axes == (slow,)  # type: ignore[union-attr]
    (remark,) = found.design.remarks  # type: ignore[union-attr]
    assert "155 Hz" in remark
    assert "135 % overshoot" in remark
    assert "26 Hz" in remark


def controller(patch: pytest.MonkeyPatch, broken: str = "", error: Exception | None = None) -> Any:
    """Return what becomes of a controller of which one step raises."""

    def step(name: str) -> Callable[..., Any]:
        def run(*_: Any, **__: Any) -> Any:
            if name == broken and error is not None:
                raise error
            return STEPS[name]

        return run

    for name in STEPS:  # not by its path: piezoid.design and piezoid.export are the verbs
        module, _, function = name.rpartition(".")
        patch.setattr(import_module(module), function, step(name))
    model: Any = SimpleNamespace(coupled=None)
    content = json.dumps({"digest": "m"}).encode()
    one: Any = Outcome(axis="x", design=Loop(bandwidth_Hz=50.0))  # type: ignore[arg-type]
    designed = (Designed(outcomes=(one,)),)
    return controllers_of(model, content, None, lambda _: None, designed=designed)


def test_a_controller_that_was_verified_ships(monkeypatch: pytest.MonkeyPatch) -> None:
    found = controller(monkeypatch)
    assert found.parameters is PARAMETERS
    assert found.reason == ""
    assert found.passed


def test_an_axis_that_does_not_ship_is_told_and_keeps_no_other_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rest = SimpleNamespace(unshipped={"z": "ceiling_A is missing"})
    step = "piezoid.verification.shipping.shipping_of"
    ships = SimpleNamespace(**{**vars(STEPS[step]), "parameters": rest})
    monkeypatch.setitem(STEPS, step, ships)
    found = controller(monkeypatch)
    assert found.verification is not None
    assert found.unshipped == {"z": "ceiling_A is missing"}
    assert not found.passed


def test_what_nobody_declared_is_no_failure_but_a_limit_nothing_meets_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    said = {"needed": "more", "remedy": "Ask for less."}
    step = "piezoid.design.stage.design_of"
    assert controller(monkeypatch, step, DesignError("no pole is declared", **said)).passed
    assert not controller(monkeypatch, step, TemplateError("missed by 3 dB", **said)).passed


@pytest.mark.parametrize("broken", STEPS)
@pytest.mark.parametrize("kind", [DesignError, RuntimeLibraryError])
def test_a_refusal_of_any_step_is_told_and_nothing_ships(
    monkeypatch: pytest.MonkeyPatch, broken: str, kind: type[PiezoidError]
) -> None:
    found = controller(monkeypatch, broken, kind("9 N", needed="8 N", remedy="Push less."))
    assert found.reason == "9 N. Needed: 8 N. Push less."
    assert not found.stumbled
    assert (found.parameters, found.verification) == (None, None)


@pytest.mark.parametrize("broken", STEPS)
def test_a_mistake_of_ours_is_told_as_one_and_nothing_ships(
    monkeypatch: pytest.MonkeyPatch, broken: str
) -> None:
    found = controller(monkeypatch, broken, ValueError("40 states"))
    assert found.reason == "a mistake of ours, ValueError: 40 states"
    assert found.stumbled
    assert (found.parameters, found.verification) == (None, None)
    assert (found.design is None) == ("design" in broken)
