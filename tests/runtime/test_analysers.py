"""Static analysers report nothing about the shipped C sources."""

import io
import zipfile

import pytest

from piezoid.export.bundle import bundle
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import target_files
from tests.runtime.compiler import STRICT, require_tool, run, write_files
from tests.verification.rig import PLANTS, stage

EXCLUDED = (
    # Every call has several pz_real arguments; the comments of the header name them.
    "bugprone-easily-swappable-parameters",
    # sizeof(member) / sizeof(pz_real) is intentionally 1 for a scalar member.
    "bugprone-sizeof-expression",
    # One translation unit keeps the names of the runtime inside the unit or library.
    "bugprone-suspicious-include",
)
# The example reads a table of piezoid with scanf and prints to a terminal.
EXCLUDED_OF_EXAMPLE = (*EXCLUDED, "cert-err33-c", "cert-err34-c")
SHIPPED = {
    "piezoid_runtime.c": EXCLUDED,
    "example_main.c": EXCLUDED_OF_EXAMPLE,
    "piezoid_controller.c": EXCLUDED,
    "controller/fmu2.c": EXCLUDED,
    "plant/fmu2.c": EXCLUDED,
}
# clang-tidy reports on the named file only; the others analyse the sources that it includes.
WITH_INCLUDED = ("example_main.c", "controller/fmu2.c", "plant/fmu2.c")


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shipped")
    files = dict(bundle(stage("x")))
    inputs = TargetInputs(file=stage("x"), plants=(PLANTS[0],))
    for path, content in target_files(inputs, ["fmu", "library"])[0].items():
        if path.startswith("library/"):
            files[path.removeprefix("library/")] = content
        elif path.endswith(".fmu"):
            role = "plant" if "_plant_" in path else "controller"
            with zipfile.ZipFile(io.BytesIO(content)) as unit:
                names = [name for name in unit.namelist() if name.startswith("sources/")]
                files |= {f"{role}/{name.split('/')[1]}": unit.read(name) for name in names}
    return write_files(folder, files)


@pytest.mark.parametrize("name", SHIPPED)
def test_clang_tidy_finds_nothing(sources, name):
    tool = require_tool("clang-tidy")
    checks = ",".join(["-*", "bugprone-*", "cert-*", *(f"-{check}" for check in SHIPPED[name])])
    run(
        *(tool, "--quiet", f"--checks={checks}", "--warnings-as-errors=*"),
        *(str(sources / name), "--", "-std=c99", f"-I{sources}"),
    )


@pytest.mark.parametrize("name", WITH_INCLUDED)
def test_cppcheck_finds_nothing(sources, name):
    checks = ("--std=c99", "--enable=warning,style,portability,performance", "--inconclusive")
    suppressions = [
        f"--suppress={check}"
        for check in (
            "missingIncludeSystem",
            # sizeof(pz_real) == sizeof(float) depends on the build.
            "duplicateExpression",
            # The FMI standard prescribes the signature of callbacks.
            "constParameter",
            "constParameterCallback",
            "unusedStructMember",
        )
    ]
    run(
        *(require_tool("cppcheck"), *checks, *suppressions, "--error-exitcode=1", "--quiet"),
        *(f"-I{sources}", str(sources / name)),
    )


@pytest.mark.parametrize("name", WITH_INCLUDED)
def test_the_analyser_of_gcc_finds_nothing(sources, name, tmp_path):
    run(
        *(require_tool("gcc"), *STRICT, "-fanalyzer", f"-I{sources}"),
        *("-c", str(sources / name), "-o", str(tmp_path / "made.o")),
    )
