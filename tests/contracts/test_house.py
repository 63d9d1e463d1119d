"""Rules for all product code."""

import ast
import dataclasses
import importlib
import pkgutil
import tomllib
from functools import cache
from pathlib import Path
from types import ModuleType

import piezoid
from piezoid import errors

ROOT = Path(__file__).resolve().parents[2]
INSTALLED_NAMES = {"piezoid": "piezoid", "cli": "piezoid_cli", "reports": "piezoid_reports"}
INSTALLED_NAMES |= {"datasets": "piezoid_datasets"}
FORBIDDEN = {"utils", "common", "helpers", "core", "base", "manager"}


def modules() -> list[ModuleType]:
    infos = pkgutil.walk_packages(piezoid.__path__, "piezoid.")
    return [
        importlib.import_module(info.name)
        for info in infos
        if not info.name.rpartition(".")[2].startswith("_")
    ]


@cache
def sources() -> dict[Path, ast.Module]:
    paths = [path for folder in INSTALLED_NAMES for path in sorted((ROOT / folder).rglob("*.py"))]
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def test_every_package_folder_is_installed():
    configuration = tomllib.loads((ROOT / "pyproject.toml").read_text())
    installed = set(configuration["tool"]["setuptools"]["packages"])
    present = {
        ".".join([INSTALLED_NAMES[folder], *path.parent.relative_to(ROOT / folder).parts])
        for folder in INSTALLED_NAMES
        for path in (ROOT / folder).rglob("__init__.py")
    }
    assert installed == present


def test_every_record_is_frozen_and_keyword_only():
    for module in modules():
        for value in vars(module).values():
            if not (isinstance(value, type) and dataclasses.is_dataclass(value)):
                continue
            if value.__module__ != module.__name__ or value.__name__.startswith("_"):
                continue
            parameters = value.__dataclass_params__  # type: ignore[attr-defined]
            if not parameters.frozen:
                # A filter or row maker has state between chunks and a method `run`.
                assert hasattr(value, "run"), f"{module.__name__}.{value.__name__} is mutable"
                continue
            fields = dataclasses.fields(value)
            assert all(field.kw_only for field in fields), f"{value.__name__} is positional"


def test_every_module_has_a_docstring_and_a_specific_name():
    for path, tree in sources().items():
        assert ast.get_docstring(tree), path
        assert not {path.stem, path.parent.name} & FORBIDDEN, path


def test_every_private_name_is_used():
    defined, referenced = set(), set()
    for tree in sources().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                defined.add(node.name)
            elif isinstance(node, ast.Attribute):
                referenced.add(node.attr)
            elif isinstance(node, ast.Name):
                (referenced if isinstance(node.ctx, ast.Load) else defined).add(node.id)
            elif isinstance(node, ast.ImportFrom):
                referenced.update(alias.name for alias in node.names)
    private = {name for name in defined if len(name) > 1 and name == "_" + name.strip("_")}
    assert private - referenced == set()


def test_the_library_neither_prints_nor_reads_clock_or_environment():
    for path, tree in sources().items():
        for node in ast.walk(tree) if path.is_relative_to(ROOT / "piezoid") else ():
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = {alias.name for alias in node.names} | {getattr(node, "module", "") or ""}
                assert not names & {"time", "datetime", "os.environ", "matplotlib"}, path
            if isinstance(node, ast.Attribute):
                assert node.attr != "environ", path


def test_every_error_has_three_parts_and_a_status():
    classes = [
        value
        for value in vars(errors).values()
        if isinstance(value, type) and issubclass(value, errors.PiezoidError)
    ]
    assert len(classes) > 10
    for kind in classes:
        error = kind("found 3 V", needed="at least 5 V", remedy="Turn the knob.", found_V=3.0)
        assert str(error) == "found 3 V. Needed: at least 5 V. Turn the knob."
        assert error.exit_status in {2, 3, 4}
        assert error.numbers == {"found_V": 3.0}
        assert kind.__name__ in (errors.__doc__ or "") or kind is errors.PiezoidError
