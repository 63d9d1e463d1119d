"""Every public function and method has an example in its docstring, and all of them run.

The examples begin where the example at the head of the package ends: its lines run first.
"""

import doctest
import importlib
import inspect
import textwrap
from functools import cache
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot

import piezoid
import piezoid_datasets
from tests.api.examples import own_data
from tests.plays_alone import fit_one_order, fit_plays_alone

mpl.use("Agg")

ROWS = 2500
# Their examples leave names that the methods of what they return go on with.
FIRST = ("fit_coupled",)


def _documented() -> dict[str, Any]:
    """Return every public function, and every public method of a public record, by name."""
    found = {}
    for name in piezoid.__all__:
        value = getattr(piezoid, name)
        if inspect.isfunction(value):
            found[name] = value
        elif inspect.isclass(value):
            for own, held in vars(value).items():
                method = held.__func__ if isinstance(held, staticmethod) else held
                if inspect.isfunction(method) and not own.startswith("_"):
                    found[f"{name}.{own}"] = method
    return found


DOCUMENTED = _documented()


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what the lines at the head of the package leave, and the folder they ran in."""
    folder = tmp_path_factory.mktemp("examples")
    for name in ("sweep", "check"):
        rows = (piezoid_datasets.FOLDER / f"x_{name}.csv").read_text().splitlines()
        (folder / f"{name}.csv").write_text("\n".join(rows[: ROWS + 1]) + "\n")
    rig, _, _ = piezoid_datasets.LAB.read_text().partition("[[recording]]")
    (folder / "lab.toml").write_text(rig)
    head = [line for line in (piezoid.__doc__ or "").splitlines() if line.startswith("    ")]
    kept: dict[str, Any] = {"np": np, "folder": folder, **own_data()}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        fit_plays_alone(patch)
        fit_one_order(patch)
        exec(textwrap.dedent("\n".join(head)), kept)
        for name in FIRST:
            assert _run(name, kept) == 0
    return kept


def _run(name: str, kept: dict[str, Any]) -> int:
    """Run the examples of a docstring in these names; return how many failed."""
    written = inspect.getdoc(DOCUMENTED[name]) or ""
    test = doctest.DocTestParser().get_doctest(written, kept, name, None, None)
    assert test.examples, f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    failed = runner.run(test, clear_globs=False).failed
    kept.update(test.globs)
    pyplot.close("all")
    return failed


def test_every_public_function_and_method_has_an_example() -> None:
    assert len(DOCUMENTED) > 50
    without = [name for name, held in DOCUMENTED.items() if ">>> " not in (held.__doc__ or "")]
    assert without == []


@pytest.mark.slow
@pytest.mark.usefixtures("plays_alone", "one_order")
def test_the_examples_of_all_docstrings_run(
    names: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(names["folder"])
    monkeypatch.setattr(piezoid, "calibrate", cache(piezoid.calibrate))  # two examples, one stage
    failed = []
    for name, held in DOCUMENTED.items():
        module = vars(importlib.import_module(held.__module__))
        own = {key: value for key, value in module.items() if not key.startswith("__")}
        if name not in FIRST and _run(name, {**own, **names}):
            failed.append(name)
    assert failed == []
