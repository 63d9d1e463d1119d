"""Every file that a package reads at run time is part of the wheel."""

import tomllib
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).parents[2]
MADE = {".py", ".pyc", ".so", ".pyd"}  # modules, and what a build makes of them and of C sources


def test_files_beside_the_modules_are_declared_as_package_data():
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    compiled = {source for module in setup["ext-modules"] for source in module["sources"]}
    undeclared = set()
    for name in ("piezoid", "piezoid_cli", "piezoid_datasets", "piezoid_reports"):
        top = ROOT / setup["package-dir"][name]
        patterns = [
            f"{owner.removeprefix(name).lstrip('.').replace('.', '/')}/{pattern}".lstrip("/")
            for owner, owned in setup["package-data"].items()
            if owner.partition(".")[0] == name
            for pattern in owned
        ]
        assert patterns or name == "piezoid_cli"
        for path in top.rglob("*"):
            relative = path.relative_to(top).as_posix()
            is_data = path.is_file() and path.suffix not in MADE
            is_read = is_data and path.relative_to(ROOT).as_posix() not in compiled
            if is_read and not any(fnmatch(relative, pattern) for pattern in patterns):
                undeclared.add(relative)
    assert undeclared == set()
