"""The C modules for Windows export their init function and every called function."""

import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from typing import Any

import pytest

from piezoid.operators.library import KERNELS
from piezoid.runtime.library import library as runtime
from piezoid.verification.loop_plant import loop_library

ROOT = Path(__file__).resolve().parents[2]
SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text())
MODULES: dict[str, dict[str, Any]] = {
    module["name"]: module for module in SETTINGS["tool"]["setuptools"]["ext-modules"]
}
LIBRARIES = {
    "piezoid.operators._kernels": lambda: KERNELS,
    "piezoid.runtime._runtime": lambda: runtime("double").code,
    "piezoid.runtime._runtime32": lambda: runtime("float").code,
    "piezoid.verification._plant_loop": loop_library,
}


@pytest.mark.parametrize("name", MODULES)
def test_every_called_function_is_exported(name):
    library = LIBRARIES[name]()
    called = {member for member in vars(library) if re.match("p[klz]_", member)}
    assert called == set(MODULES[name]["export-symbols"])


@pytest.mark.parametrize("name", MODULES)
def test_a_module_links_for_windows_with_its_exported_names(name, tmp_path):
    compiler, reader = (shutil.which(f"x86_64-w64-mingw32-{tool}") for tool in ("gcc", "objdump"))
    if compiler is None or reader is None:
        pytest.skip("no cross compiler for Windows on this machine (gcc-mingw-w64-x86-64)")
    module = MODULES[name]
    # setuptools adds the init function to the exported symbols.
    symbols = {*module["export-symbols"], "PyInit_" + name.rpartition(".")[2]}
    names = tmp_path / "module.def"
    names.write_text("EXPORTS\n" + "\n".join(sorted(symbols)) + "\n")
    macros = [f"-D{key}={value}" for key, value in module.get("define-macros", ())]
    output = tmp_path / "module.pyd"
    subprocess.run(
        [
            *(compiler, "-shared", "-Wall", "-Wextra", "-Werror", *module["extra-compile-args"]),
            *(*macros, *module["sources"], str(names), "-o", str(output)),
        ],
        cwd=ROOT,
        check=True,
    )
    listing = subprocess.run(
        [reader, "-p", str(output)], capture_output=True, text=True, check=True
    )
    table = listing.stdout.split("[Ordinal/Name Pointer] Table")[1].split("\n\n")[0]
    assert set(re.findall(r"\b(?:p[klz]_|sb_|PyInit_)\w+", table)) == symbols
