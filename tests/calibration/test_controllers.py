"""Whatever stands in the way of a controller, model and report do not get lost."""

import json
from collections.abc import Callable
from importlib import import_module
from types import SimpleNamespace
from typing import Any

import pytest

from piezoid.calibration.controllers import controllers_of
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
    model: Any = None
    content = json.dumps({"digest": "m"}).encode()
    return controllers_of(model, content, None, lambda _: None, designed=())


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
