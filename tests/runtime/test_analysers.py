"""What analysers of C say of everything that ships: nothing."""

import io
import zipfile

import pytest

from piezoid.export.bundle import bundle
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import target_files
from tests.runtime.compiler import PRECISION, STRICT, found, run, write_files
from tests.verification.rig import PLANTS, stage

# Why the others are left out:
LEFT_OUT = (
    # pz_real arguments stand side by side in every call: the header's comments name them
    "bugprone-easily-swappable-parameters",
    # sizeof(member) / sizeof(pz_real) is 1 where a member is no array, and that is meant
    "bugprone-sizeof-expression",
    # one translation unit: names of the runtime must not be seen outside of the unit or library
    "bugprone-suspicious-include",
)
# The example reads a table that piezoid wrote with scanf and prints to a terminal
EXAMPLE_LEFT_OUT = (*LEFT_OUT, "cert-err33-c", "cert-err34-c")
SHIPPED = {
    "piezoid_runtime.c": LEFT_OUT,
    "example_main.c": EXAMPLE_LEFT_OUT,
    "piezoid_controller.c": LEFT_OUT,
    "controller/fmu2.c": LEFT_OUT,
    "plant/fmu2.c": LEFT_OUT,
}
# Units and the library are in double precision
ASKED = [(name, "double") for name in SHIPPED] + [(name, "float") for name in list(SHIPPED)[:2]]


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    folder = tmp_path_factory.mktemp("shipped")
    made = dict(bundle(stage("x")))
    exported = TargetInputs(file=stage("x"), plants=(PLANTS[0],))
    for place, content in target_files(exported, ["fmu", "library"]).files.items():
        if place.startswith("library/"):
            made[place.removeprefix("library/")] = content
        elif place.endswith(".fmu"):
            which = "plant" if "_plant_" in place else "controller"
            with zipfile.ZipFile(io.BytesIO(content)) as unit:
                inside = [name for name in unit.namelist() if name.startswith("sources/")]
                made |= {f"{which}/{name.split('/')[1]}": unit.read(name) for name in inside}
    return write_files(folder, made)


@pytest.mark.parametrize(("name", "precision"), ASKED)
def test_clang_tidy_finds_nothing(sources, name, precision):
    tool = found("clang-tidy")
    asked = ",".join(["-*", "bugprone-*", "cert-*", *(f"-{one}" for one in SHIPPED[name])])
    run(
        *(tool, "--quiet", f"--checks={asked}", "--warnings-as-errors=*"),
        *(str(sources / name), "--", "-std=c99", f"-I{sources}", *PRECISION[precision]),
    )


@pytest.mark.parametrize(("name", "precision"), ASKED)
def test_cppcheck_finds_nothing(sources, name, precision):
    checks = ("--std=c99", "--enable=warning,style,portability,performance", "--inconclusive")
    hidden = [
        f"--suppress={one}"
        for one in (
            "missingIncludeSystem",
            # sizeof(pz_real) == sizeof(float) is a question of the build
            "duplicateExpression",
            # callbacks have the form that the standard of the units gives them
            "constParameter",
            "constParameterCallback",
            "unusedStructMember",
        )
    ]
    run(
        *(found("cppcheck"), *checks, *hidden, "--error-exitcode=1", "--quiet"),
        *(*PRECISION[precision], f"-I{sources}", str(sources / name)),
    )


@pytest.mark.parametrize(("name", "precision"), ASKED)
def test_the_analyser_of_gcc_finds_nothing(sources, name, precision, tmp_path):
    run(
        *(found("gcc"), *STRICT, "-fanalyzer", *PRECISION[precision], f"-I{sources}"),
        *("-c", str(sources / name), "-o", str(tmp_path / "made.o")),
    )
