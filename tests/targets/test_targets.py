"""Targets beside the bundle, opened by the tools of users and compared bit for bit."""

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
from piezoid.targets.target_inputs import TargetInputs
from piezoid.targets.targets import check_targets, target_files
from tests.export.stage import stage
from tests.runtime.compiler import STRICT, require_tool, run, write_files
from tests.runtime.runtime_parameters import started
from tests.targets.known_inputs import csv_rows
from tests.targets.slave import Slave

COMPILED = ("fmu", "library")
FMU_NAMES = [f"fmu/{axis}_controller_fmi2.fmu" for axis in "xyz"]


@pytest.fixture(scope="module")
def files():
    require_tool("cc", "gcc", "clang")
    contents, _ = target_files(TargetInputs(file=stage()), COMPILED)
    return contents


@pytest.fixture(scope="module")
def target_folder(files, tmp_path_factory):
    return write_files(tmp_path_factory.mktemp("targets"), files)


def golden(axis):
    rows = [row for row in csv_rows(golden_csv(stage()).encode()) if row["axis"] == axis]
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_equal_parameters_give_equal_bytes_and_the_bundle_adds_nothing(files):
    repeated, _ = target_files(TargetInputs(file=stage()), COMPILED)
    assert dict(files) == dict(repeated)
    of_bundle, _ = target_files(TargetInputs(file=stage()), check_targets(["bundle"]))
    assert not of_bundle


@pytest.mark.parametrize("name", ["pi-pid", "biquad"])
def test_a_replaced_target_is_refused_with_its_successor(name):
    with pytest.raises(ParameterFileError, match=rf"'{name}' was replaced by 'pid'.*--target pid"):
        check_targets([name])


def test_without_a_compiler_sources_and_a_note_are_written(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    contents, notes = target_files(TargetInputs(file=stage()), COMPILED)
    assert {name for name in contents if name.endswith(".fmu")} == set(FMU_NAMES)
    members = zipfile.ZipFile(io.BytesIO(contents[FMU_NAMES[0]])).namelist()
    assert not [name for name in members if name.startswith("binaries/")]
    assert "sources/piezoid_runtime.c" in members
    assert "library/piezoid_controller.c" in contents
    assert "library/libpiezoid_controller.so" not in contents
    assert len(notes) == 3
    assert all("no C compiler" in note for note in notes)


def test_the_example_reproduces_the_golden_table_and_detects_differences(target_folder, tmp_path):
    assert run(sys.executable, str(target_folder / "library" / "example.py")) == (
        f"{3 * SAMPLES} samples, 0 differ\n"
    )
    folder = shutil.copytree(target_folder / "library", tmp_path / "library")
    table = (folder / "golden.csv").read_text().splitlines()
    cells = table[500].split(",")
    cells[3] = repr(float(np.nextafter(float(cells[3]), 99)))
    (folder / "golden.csv").write_text("\n".join([*table[:500], ",".join(cells), *table[501:]]))
    with pytest.raises(AssertionError, match="1 differ"):
        run(sys.executable, str(folder / "example.py"))


def test_an_invalid_handle_axis_or_array_is_refused(target_folder):
    library = ctypes.CDLL(str(target_folder / "library" / "libpiezoid_controller.so"))
    library.piezoid_open.argtypes = (ctypes.c_int32, ctypes.c_double, ctypes.c_double)
    library.piezoid_rate_Hz.restype = ctypes.c_double
    value, word = (ctypes.c_double * 1)(7.0), (ctypes.c_uint32 * 1)(7)
    assert library.piezoid_axes() == 3
    assert library.piezoid_rate_Hz(0) == 20e3
    assert library.piezoid_rate_Hz(3) == 0
    for axis in (-1, 3):
        assert library.piezoid_open(axis, 0.0, 0.0) == -1
    handle = library.piezoid_open(0, 0.0, 0.0)
    assert handle > 0
    assert library.piezoid_step(handle, -1, value, value, value, word) == -4
    assert library.piezoid_step(handle, 1, value, None, value, word) == -4
    assert library.piezoid_close(handle) == 0
    renewed = library.piezoid_open(0, 0.0, 0.0)
    for invalid in (handle, 0, -5, 2**31 - 1, renewed + 1):
        assert library.piezoid_step(invalid, 1, value, value, value, word) == -3
        assert library.piezoid_reset(invalid) == -3
        assert library.piezoid_close(invalid) == -3
    assert (value[0], word[0]) == (7.0, 7)
    handles = [library.piezoid_open(1, 0.0, 0.0) for _ in range(63)]
    assert min(handles) > 0
    assert library.piezoid_open(1, 0.0, 0.0) == -2
    for handle_x in (renewed, *handles):
        assert library.piezoid_close(handle_x) == 0


@pytest.mark.parametrize("order", [1, -1])
def test_the_header_of_the_library_compiles_beside_that_of_the_runtime(
    target_folder, order, tmp_path
):
    headers = ("piezoid_controller.h", "piezoid_runtime.h")[::order]
    lines = [f'#include "{name}"' for name in headers]
    (tmp_path / "user.c").write_text("\n".join([*lines, "int bits = PZ_STATUS_LATCHED;", ""]))
    compiler, library = require_tool("cc", "gcc", "clang"), target_folder / "library"
    run(compiler, *STRICT, f"-I{library}", "-fsyntax-only", str(tmp_path / "user.c"))


def test_the_library_exports_the_names_of_its_header(target_folder):
    listing = run(
        require_tool("nm"),
        "-D",
        "--defined-only",
        str(target_folder / "library/libpiezoid_controller.so"),
    )
    names = {line.split()[-1] for line in listing.splitlines()}
    header = (target_folder / "library" / "piezoid_controller.h").read_text()
    assert names == set(re.findall(r"^PZ_PUBLIC \w+ (\w+)\(", header, flags=re.M))


def test_the_library_for_windows_exports_the_same_names(target_folder):
    require_tool("x86_64-w64-mingw32-gcc")
    listing = run(
        require_tool("x86_64-w64-mingw32-objdump"),
        "-p",
        str(target_folder / "library/piezoid_controller.dll"),
    )
    table = listing.split("[Ordinal/Name Pointer] Table")[1]
    names = set(re.findall(r"\bp(?:z|iezoid)_\w+", table))
    header = (target_folder / "library" / "piezoid_controller.h").read_text()
    assert names == set(re.findall(r"^PZ_PUBLIC \w+ (\w+)\(", header, flags=re.M))
    needed = set(re.findall(r"DLL Name: (\S+)", listing))
    assert needed <= {"KERNEL32.dll", "msvcrt.dll"}


@pytest.mark.parametrize("name", FMU_NAMES)
def test_a_unit_passes_the_validation_of_fmpy(target_folder, name):
    validation = pytest.importorskip("fmpy.validation")
    assert validation.validate_fmu(str(target_folder / name)) == []


@pytest.mark.parametrize("name", FMU_NAMES)
@pytest.mark.parametrize("stride", [1, 7])
def test_a_unit_gives_the_golden_answers_bit_for_bit(target_folder, name, stride, tmp_path):
    """Inputs are constant within a step, so longer steps use another table."""
    index = "xyz".index(name.split("/")[1][0])
    table, values = golden(str(index)), stage().axes[index].values
    rows = np.arange(SAMPLES) // stride * stride
    reference, measured = table["reference"][rows], table["measured"][rows]
    expected = started(values, measured=float(measured[0])).run(reference, measured)
    if stride == 1:
        np.testing.assert_array_equal(expected.voltage_V, table["voltage_double_V"])
    unit, answers = "A" if index == 2 else "m", []
    slave = Slave(target_folder / name, tmp_path, samples=stride)
    for k in range(0, SAMPLES // stride * stride, stride):
        slave.put(f"reference_{unit}", reference[k])
        slave.put(f"measured_{unit}", measured[k])
        slave.step()
        answers.append((slave.get("voltage_V"), slave.get("status")))
    slave.close()
    step_ends = np.arange(stride - 1, SAMPLES, stride)
    np.testing.assert_array_equal(
        np.array(answers).T, [expected.voltage_V[step_ends], expected.status[step_ends]]
    )


def test_fmpy_simulates_the_unit_from_its_description(target_folder):
    fmpy = pytest.importorskip("fmpy")
    simulation = fmpy.simulate_fmu(
        str(target_folder / "fmu/x_controller_fmi2.fmu"), start_values={"reference_m": 1e-5}
    )
    assert len(simulation["voltage_V"]) == SAMPLES + 1
    assert simulation["voltage_V"][0] == 0
    assert simulation["voltage_V"][-1] > 1
    assert np.isfinite(simulation["voltage_V"]).all()


def test_a_description_of_another_unit_is_refused(target_folder, tmp_path):
    fmpy = pytest.importorskip("fmpy")
    folder = fmpy.extract(str(target_folder / "fmu/x_controller_fmi2.fmu"), tmp_path / "x")
    description = fmpy.read_model_description(folder)
    description.guid = "another"
    with pytest.raises(Exception, match=r"[Ff]ailed to instantiate"):
        fmpy.instantiate_fmu(folder, description, fmi_type="CoSimulation")
