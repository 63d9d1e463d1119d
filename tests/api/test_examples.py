"""Every public function and method has an example in its docstring, and all examples run.

The lines of the package docstring run before the examples.
"""

import doctest
import importlib
import inspect
import textwrap
from collections.abc import Iterator
from functools import cache
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot

import piezoid
import piezoid_datasets
from tests.api.examples import coupled_data
from tests.plays_alone import design_briefly, fit_few_rows, fit_one_order, fit_plays_alone

mpl.use("Agg")

ROWS = 2500
# The methods of their results use the names of these examples.
RUN_FIRST = ("fit_coupled",)


def _documented() -> dict[str, Any]:
    """Return every public function, and every public method of a public record, by name."""
    functions = {}
    for name in piezoid.__all__:
        value = getattr(piezoid, name)
        if inspect.isfunction(value):
            functions[name] = value
        elif inspect.isclass(value):
            for attribute, member in vars(value).items():
                method = member.__func__ if isinstance(member, staticmethod) else member
                if inspect.isfunction(method) and not attribute.startswith("_"):
                    functions[f"{name}.{attribute}"] = method
    return functions


DOCUMENTED = _documented()


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """Yield the names that the package docstring defines, and its folder."""
    folder = tmp_path_factory.mktemp("examples")
    for name in ("sweep", "check"):
        rows = (piezoid_datasets.FOLDER / f"x_{name}.csv").read_text().splitlines()
        (folder / f"{name}.csv").write_text("\n".join(rows[: ROWS + 1]) + "\n")
    rig, _, _ = piezoid_datasets.LAB.read_text().partition("[[recording]]")
    (folder / "lab.toml").write_text(rig)
    head = [line for line in (piezoid.__doc__ or "").splitlines() if line.startswith("    ")]
    namespace: dict[str, Any] = {"np": np, "folder": folder, **coupled_data()}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        fit_plays_alone(patch)
        fit_one_order(patch)
        fit_few_rows(patch)
        design_briefly(patch)
        for verb in ("calibrate", "design", "export"):  # examples repeat their calls
            patch.setattr(piezoid, verb, cache(getattr(piezoid, verb)))
        exec(textwrap.dedent("\n".join(head)), namespace)
        for name in RUN_FIRST:
            assert _run(name, namespace) == 0
        yield namespace


def _run(name: str, namespace: dict[str, Any]) -> int:
    """Run the examples of a docstring with these names; return the number of failures."""
    docstring = inspect.getdoc(DOCUMENTED[name]) or ""
    test = doctest.DocTestParser().get_doctest(docstring, namespace, name, None, None)
    assert test.examples, f"{name} has no example"
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS)
    failures = runner.run(test, clear_globs=False).failed
    namespace.update(test.globs)
    pyplot.close("all")
    return failures


def test_every_public_function_and_method_has_an_example():
    assert len(DOCUMENTED) > 50
    without = [
        name for name, function in DOCUMENTED.items() if ">>> " not in (function.__doc__ or "")
    ]
    assert without == []


@pytest.mark.slow
def test_the_examples_of_all_docstrings_run(names):
    failed = []
    for name, function in DOCUMENTED.items():
        module = vars(importlib.import_module(function.__module__))
        globals_of_module = {
            key: value for key, value in module.items() if not key.startswith("__")
        }
        if name not in RUN_FIRST and _run(name, {**globals_of_module, **names}):
            failed.append(name)
    assert failed == []
