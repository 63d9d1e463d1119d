"""What is written beside the bundle: opened by the tools that people own, compared bit for bit."""

import csv
import ctypes
import io
import re
import shutil
import sys
import zipfile

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.export.bundle import SAMPLES, golden_csv
from piezoid.runtime.controller import Controller
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import check_targets, target_files
from tests.export.stage import stage
from tests.runtime.compiler import STRICT, found, run, write_files
from tests.targets.slave import Slave

COMPILED = ("fmu", "library")
FMU_NAMES = [f"fmu/{axis}_controller_fmi2.fmu" for axis in "xyz"]


@pytest.fixture(scope="module")
def files():
    found("cc", "gcc", "clang")
    return target_files(TargetInputs(file=stage()), COMPILED).files


@pytest.fixture(scope="module")
def made(files, tmp_path_factory):
    return write_files(tmp_path_factory.mktemp("made"), files)


def golden(axis):
    rows = [row for row in csv.DictReader(io.StringIO(golden_csv(stage()))) if row["axis"] == axis]
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_the_same_parameters_give_the_same_bytes_for_every_target(files):
    again = target_files(TargetInputs(file=stage()), COMPILED).files
    assert dict(files) == dict(again)


@pytest.mark.parametrize("name", ["pi-pid", "biquad"])
def test_a_replaced_target_is_refused_with_its_successor(name):
    with pytest.raises(ParameterFileError, match=rf"'{name}' was replaced by 'pid'.*--target pid"):
        check_targets([name])


def test_the_bundle_alone_adds_nothing():
    assert not target_files(TargetInputs(file=stage()), check_targets(["bundle"])).files


def test_without_a_compiler_the_sources_are_written_and_a_note_says_what_is_missing(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("PATH", str(tmp_path))
    done = target_files(TargetInputs(file=stage()), COMPILED)
    assert {name for name in done.files if name.endswith(".fmu")} == set(FMU_NAMES)
    inside = zipfile.ZipFile(io.BytesIO(done.files[FMU_NAMES[0]])).namelist()
    assert not [name for name in inside if name.startswith("binaries/")]
    assert "sources/piezoid_runtime.c" in inside
    assert "library/piezoid_controller.c" in done.files
    assert "library/libpiezoid_controller.so" not in done.files
    assert len(done.notes) == 3
    assert all("no C compiler" in note for note in done.notes)


def test_the_example_plays_the_golden_table_through_the_library(made):
    assert run(sys.executable, str(made / "library" / "example.py")) == (
        f"{3 * SAMPLES} samples, 0 differ\n"
    )


def test_the_example_notices_another_answer(made, tmp_path):
    folder = shutil.copytree(made / "library", tmp_path / "library")
    table = (folder / "golden.csv").read_text().splitlines()
    cells = table[500].split(",")
    cells[3] = repr(float(np.nextafter(float(cells[3]), 99)))
    (folder / "golden.csv").write_text("\n".join([*table[:500], ",".join(cells), *table[501:]]))
    with pytest.raises(AssertionError, match="1 differ"):
        run(sys.executable, str(folder / "example.py"))


def test_a_wrong_handle_axis_or_array_is_refused_and_nothing_is_written(made):
    library = ctypes.CDLL(str(made / "library" / "libpiezoid_controller.so"))
    library.piezoid_open.argtypes = (ctypes.c_int32, ctypes.c_double, ctypes.c_double)
    library.piezoid_rate_Hz.restype = ctypes.c_double
    one, word = (ctypes.c_double * 1)(7.0), (ctypes.c_uint32 * 1)(7)
    assert library.piezoid_axes() == 3
    assert library.piezoid_rate_Hz(0) == 20e3
    assert library.piezoid_rate_Hz(3) == 0
    for axis in (-1, 3):
        assert library.piezoid_open(axis, 0.0, 0.0) == -1
    handle = library.piezoid_open(0, 0.0, 0.0)
    assert handle > 0
    assert library.piezoid_step(handle, -1, one, one, one, word) == -4
    assert library.piezoid_step(handle, 1, one, None, one, word) == -4
    assert library.piezoid_close(handle) == 0
    renewed = library.piezoid_open(0, 0.0, 0.0)
    for wrong in (handle, 0, -5, 2**31 - 1, renewed + 1):
        assert library.piezoid_step(wrong, 1, one, one, one, word) == -3
        assert library.piezoid_reset(wrong) == -3
        assert library.piezoid_close(wrong) == -3
    assert (one[0], word[0]) == (7.0, 7)
    others = [library.piezoid_open(1, 0.0, 0.0) for _ in range(63)]
    assert min(others) > 0
    assert library.piezoid_open(1, 0.0, 0.0) == -2
    for opened in (renewed, *others):
        assert library.piezoid_close(opened) == 0


@pytest.mark.parametrize("order", [1, -1])
def test_the_header_of_the_library_compiles_beside_that_of_the_runtime(made, order, tmp_path):
    headers = ("piezoid_controller.h", "piezoid_runtime.h")[::order]
    lines = [f'#include "{name}"' for name in headers]
    (tmp_path / "user.c").write_text("\n".join([*lines, "int bits = PZ_STATUS_LATCHED;", ""]))
    compiler, folder = found("cc", "gcc", "clang"), made / "library"
    run(compiler, *STRICT, f"-I{folder}", "-fsyntax-only", str(tmp_path / "user.c"))


def test_the_library_shows_no_name_but_those_of_its_header(made):
    listed = run(
        found("nm"), "-D", "--defined-only", str(made / "library/libpiezoid_controller.so")
    )
    shown = {line.split()[-1] for line in listed.splitlines()}
    header = (made / "library" / "piezoid_controller.h").read_text()
    assert shown == set(re.findall(r"^PZ_PUBLIC \w+ (\w+)\(", header, flags=re.M))


def test_a_library_for_windows_shows_the_same_names(made):
    found("x86_64-w64-mingw32-gcc")
    listed = run(
        found("x86_64-w64-mingw32-objdump"), "-p", str(made / "library/piezoid_controller.dll")
    )
    table = listed.split("[Ordinal/Name Pointer] Table")[1]
    shown = set(re.findall(r"\bp(?:z|iezoid)_\w+", table))
    header = (made / "library" / "piezoid_controller.h").read_text()
    assert shown == set(re.findall(r"^PZ_PUBLIC \w+ (\w+)\(", header, flags=re.M))
    needed = set(re.findall(r"DLL Name: (\S+)", listed))
    assert needed <= {"KERNEL32.dll", "msvcrt.dll"}


@pytest.mark.parametrize("name", FMU_NAMES)
def test_fmpy_has_no_finding(made, name):
    validation = pytest.importorskip("fmpy.validation")
    assert validation.validate_fmu(str(made / name)) == []


@pytest.mark.parametrize("name", FMU_NAMES)
@pytest.mark.parametrize("stride", [1, 7])
def test_the_golden_answers_come_out_of_the_unit_bit_for_bit(made, name, stride, tmp_path):
    """Inputs are held for a step: with longer steps another table is compared."""
    place = "xyz".index(name.split("/")[1][0])
    table, values = golden(str(place)), stage().axes[place].values
    held = np.arange(SAMPLES) // stride * stride
    reference, measured = table["reference"][held], table["measured"][held]
    controller = Controller(values)
    controller.start(0.0, float(measured[0]))
    expected = controller.run(reference, measured)
    if stride == 1:
        np.testing.assert_array_equal(expected.voltage_V, table["voltage_double_V"])
    unit, answers = "A" if place == 2 else "m", []
    slave = Slave(made / name, tmp_path, samples=stride)
    for k in range(0, SAMPLES // stride * stride, stride):
        slave.put(f"reference_{unit}", reference[k])
        slave.put(f"measured_{unit}", measured[k])
        slave.step()
        answers.append((slave.get("voltage_V"), slave.get("status")))
    slave.close()
    last = np.arange(stride - 1, SAMPLES, stride)
    np.testing.assert_array_equal(
        np.array(answers).T, [expected.voltage_V[last], expected.status[last]]
    )


def test_a_simulator_can_run_the_unit_from_its_description_alone(made):
    fmpy = pytest.importorskip("fmpy")
    done = fmpy.simulate_fmu(
        str(made / "fmu/x_controller_fmi2.fmu"), start_values={"reference_m": 1e-5}
    )
    assert len(done["voltage_V"]) == SAMPLES + 1
    assert done["voltage_V"][0] == 0
    assert done["voltage_V"][-1] > 1
    assert np.isfinite(done["voltage_V"]).all()


def test_a_description_of_another_unit_is_refused(made, tmp_path):
    fmpy = pytest.importorskip("fmpy")
    folder = fmpy.extract(str(made / "fmu/x_controller_fmi2.fmu"), tmp_path / "x")
    described = fmpy.read_model_description(folder)
    described.guid = "of another"
    with pytest.raises(Exception, match=r"[Ff]ailed to instantiate"):
        fmpy.instantiate_fmu(folder, described, fmi_type="CoSimulation")
