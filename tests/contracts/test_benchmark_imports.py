"""Every name that the benchmarks import from the library exists."""

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

ROOT = Path(__file__).parents[2]
PACKAGES = ("piezoid", "piezoid_cli", "piezoid_reports", "piezoid_datasets")


def test_every_name_that_a_benchmark_imports_exists():
    missing = []
    for path in sorted((ROOT / "benchmarks").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom) or node.module is None:
                continue
            if node.module.partition(".")[0] not in PACKAGES:
                continue
            module = import_module(node.module)
            missing += [
                f"{path.relative_to(ROOT)}: {node.module}.{name.name}"
                for name in node.names
                if not hasattr(module, name.name)
                and (
                    not hasattr(module, "__path__") or not find_spec(f"{node.module}.{name.name}")
                )
            ]
    assert not missing
