"""The table of parameters agrees with the C sources and refuses invalid values."""

import ctypes
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import piezoid.runtime
from piezoid.errors import ParameterFileError, RuntimeLibraryError
from piezoid.numerics import compiled
from piezoid.runtime import schema
from piezoid.runtime.controller import Status
from piezoid.runtime.library import compare_layout, complete, library
from piezoid.runtime.schema import METHODS, PARAMETERS
from tests.runtime.compiler import SOURCE, require_tool, run
from tests.runtime.observer_design import observer_parameters
from tests.runtime.runtime_parameters import WIDE, WORKED, hysteresis, tunnelling

HEADER = (Path(piezoid.runtime.__file__).parent / "piezoid_runtime.h").read_text()
SEALED = ("schema", "size_bytes", "checksum")
NOTCH = np.array([1, -1.9, 0.95, -1.8, 0.85])

CREEP = {"relaxation_count": 1, "relaxation_rate": [0.1], "relaxation_share": [0.01]}
LATERAL = {**hysteresis(WORKED), **observer_parameters(), **CREEP, "method": "mpi_dob"}


def refused_name(values, precision="double"):
    """Return the name of the parameter that the C check refuses, or None."""
    runtime = library(precision)
    packed = runtime.parameters()
    for parameter in PARAMETERS:
        value = padded(parameter, values.get(parameter.name, parameter.default))
        if parameter.shape:
            np.ctypeslib.as_array(getattr(packed, parameter.name))[...] = value
        else:
            number = int(value) if parameter.kind == "integer" else float(value)
            setattr(packed, parameter.name, number)
    runtime.seal(packed)
    index = runtime.code.pz_check(ctypes.byref(packed))
    names = {number: name for name, number in schema.INDEX.items()}
    return names[index] if index else None


def padded(parameter, value):
    if not parameter.shape:
        return np.asarray(METHODS.index(value) if isinstance(value, str) else value, float)
    array, value = np.zeros(parameter.shape), np.asarray(value, float)
    if value.ndim:
        array[tuple(slice(n) for n in value.shape)] = value
    return array


@pytest.mark.parametrize("values", [LATERAL, tunnelling()])
@pytest.mark.parametrize("parameter", [p for p in PARAMETERS if p.name not in SEALED], ids=str)
def test_every_parameter_out_of_its_bounds_is_named(parameter, values):
    """Both bounds, the first and last element of an array, and NaN are checked."""
    beyond = [parameter.lower - 1.0, parameter.upper + max(1.0, abs(parameter.upper) * 1e-6)]
    indices = {0, parameter.count - 1}
    for value in beyond if parameter.kind == "integer" else [*beyond, np.nan]:
        for index in indices:
            array = padded(parameter, values.get(parameter.name, parameter.default)).copy()
            array.ravel()[index] = value
            changed = {**values, parameter.name: array}
            assert refused_name(changed) == parameter.name
            with pytest.raises(ParameterFileError, match=parameter.name):
                complete(changed)


BAD = {
    "play_count": {"play_count": 0},
    "play_threshold_V": {"play_threshold_V": [0, 1, 1, 2]},
    "play_weight_m_per_V": {"play_weight_m_per_V": [0.5, -0.6, 1, 1]},
    "play_memory_V": {"play_memory_V": [0, 2, 0, 0]},
    "edge_count": {"edge_count": 1},
    "edge_steps": {"edge_count": 3, "play_value_m": np.tile([-1.0, 0.0, 1.0], (4, 1))},
    "play_value_m": {
        **{"edge_count": 3, "edge_steps": 2},
        "play_value_m": [[-1, 0, 1], [0, 0, 0], [0, 1, 0.5], [0, 0, 0]],
    },
    "envelope_knot_V": {"envelope_count": 2, "envelope_knot_V": [1, 2]},
    "envelope_weight": {"envelope_count": 1, "envelope_weight": [0.0]},
    "polarity": {"polarity": 0},
    "knot_m": {"knot_m": [-2, -1, 0.1, 1, 2]},
    "knot_weight": {"knot_weight": [-0.1, -0.2, 1, 0.3, -1.3]},
    "relaxation_rate": {"relaxation_rate": [0.0]},
    "reference_section": {"reference_section_count": 1, "reference_section": [[2, 0, 0, 0, 0]]},
    "command_section": {"command_section_count": 1, "command_section": [[3, 0, 0, 0, 2.0]]},
    "observer_order": {"observer_order": 0},
    "observer_rest": {"observer_rest": observer_parameters()["observer_rest"] * 1.0001},
    "observer_C": {"observer_C": observer_parameters()["observer_C"] * 1.0001},
    "feedback_N_V_per_m": {"feedback_N_V_per_m": 0.85},
    "gain_m_per_V": {"gain_m_per_V": 0.0},
    "voltage_maximum_V": {"voltage_maximum_V": -1000.0},
    "lsb_V": {"lsb_V": 1e-5},
    "reference_maximum_m": {"reference_maximum_m": -1000.0},
    "displacement_maximum_m": {"displacement_maximum_m": -1000.0},
}
BAD_RST = {
    "current_floor_A": {"current_floor_A": 0.0},
    "current_reference_A": {"current_reference_A": 1e-12},
    "current_ceiling_A": {"current_ceiling_A": 1e-9},
    "retract_voltage_V": {"retract_voltage_V": -10.5},
    "retract_samples": {"retract_samples": 0},
    "rst_T_count": {"rst_T_count": 0},
    "rst_R_count": {"rst_R_count": 0},
    "rst_S": {"rst_S": [2.0, 0.1]},
    "rst_A0": {"rst_A0_count": 0},
    "command_section_count": {"command_section_count": 1, "command_section": [[1, 0, 0, 0, 0]]},
    "relaxation_count": CREEP,
}


@pytest.mark.parametrize(
    ("values", "bad"),
    [*((LATERAL, bad) for bad in BAD.items()), *((tunnelling(), bad) for bad in BAD_RST.items())],
)
def test_inconsistent_parameters_are_named(values, bad):
    name, change = bad
    assert refused_name({**values, **change}) == name
    with pytest.raises(ParameterFileError, match=name):
        library().pack(complete({**values, **change}))


@pytest.mark.parametrize("precision", ["double", "float"])
def test_every_changed_bit_of_the_packed_parameters_is_refused(precision):
    runtime = library(precision)
    packed = runtime.pack(complete(LATERAL))
    content = np.frombuffer(packed, dtype=np.uint8)
    for index in range(0, len(content), 7):
        content[index] ^= 1 << (index % 8)
        assert runtime.code.pz_check(ctypes.byref(packed)) in (1, 2, 3)
        content[index] ^= 1 << (index % 8)
    assert runtime.code.pz_check(ctypes.byref(packed)) == 0


def test_the_checksum_is_the_common_crc_of_everything_behind_it():
    import zlib

    runtime = library()
    packed = runtime.pack(complete(LATERAL))
    content = bytes(packed)[runtime.parameters.method.offset :]
    assert packed.checksum == zlib.crc32(content)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("REAL(lsb_V, 0, 1e3)", "REAL(lsb_V, 0, 5)", "another layout: line"),
        ("index < PZ_PARAMETER_END", "index <= PZ_PARAMETER_END", "length of the parameter table"),
        ("index < PZ_PARAMETER_END", "index + 1 < PZ_PARAMETER_END", "another layout: line"),
    ],
    ids=["another bound", "a member more", "a member less"],
)
def test_a_library_of_another_table_is_refused(old, new, message, tmp_path):
    """The library is compiled from a source with another schema."""
    source = (SOURCE / "piezoid_runtime.c").read_text()
    assert old in source
    (tmp_path / "runtime.c").write_text(source.replace(old, new))
    sources = ("runtime.c", str(SOURCE / "run_many.c"))
    shared = ("-shared", "-fPIC", f"-I{SOURCE}", *sources, "-o", "runtime.so")
    run(require_tool("cc", "gcc", "clang"), *shared, cwd=tmp_path)
    code = ctypes.CDLL(str(tmp_path / "runtime.so"))
    for name in ("pz_describe", "pz_size_of_real"):
        getattr(code, name).restype = getattr(library().code, name).restype
    with pytest.raises(RuntimeLibraryError, match=message):
        compare_layout(replace(library(), code=code))


def test_sizes_methods_and_status_bits_are_those_of_the_header():
    for name in ("PLAYS", "KNOTS", "RELAXATIONS", "SECTIONS", "ORDER", "TAPS"):
        assert f"#define PZ_MAX_{name} {getattr(schema, f'MAX_{name}')}\n" in HEADER
    assert f"#define PZ_SCHEMA_VERSION {schema.VERSION}\n" in HEADER
    methods = re.findall(r"PZ_METHOD_(\w+) = (\d+)", HEADER)
    assert [(name.lower(), int(value)) for name, value in methods] == [
        (name, index) for index, name in enumerate(METHODS)
    ]
    bits = re.findall(r"PZ_STATUS_(\w+) = (\d+)", HEADER)
    assert {name: int(value) for name, value in bits} == {s.name: s.value for s in Status}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"play_treshold_V": 0.0}, "play_treshold_V"),
        ({"play_weight_m_per_V": np.ones(33)}, "at most"),
        ({"observer_A": np.ones(3)}, "shape"),
        ({"play_count": 2.5}, r"play_count is 2\.5"),
        ({"method": "pid"}, "method"),
    ],
)
def test_values_outside_of_the_table_are_refused(change, message):
    with pytest.raises(ParameterFileError, match=message):
        complete({**WIDE, **change})


def test_values_have_a_single_zero_and_are_read_only():
    """A value missing in a file is read as 0, so there is only one zero."""
    values = complete({**WIDE, "voltage_offset_V": -0.0, "knot_m": [-1.0, -0.0]})
    assert not np.signbit(values["voltage_offset_V"])
    assert not np.signbit(values["knot_m"][1])
    values = complete({**WIDE, "knot_m": 1.5, "play_memory_V": 1.0})
    assert (values["knot_m"] == 1.5).all()
    assert (values["play_memory_V"] == 1.0).all()
    for name, numbers in values.items():
        with pytest.raises(ValueError, match="read-only"):
            numbers[...] = 0.0
        assert not numbers.flags.writeable, name


def test_a_library_of_another_precision_or_without_code_is_refused():
    with pytest.raises(RuntimeLibraryError, match="size of pz_real is 4"):
        compare_layout(replace(library("float"), real=ctypes.c_double))
    with pytest.raises(RuntimeLibraryError, match="does not contain the compiled module"):
        compiled.opened("piezoid.runtime._never_compiled", {})
