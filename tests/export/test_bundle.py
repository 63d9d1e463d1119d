"""The bundle, compiled as a firmware engineer does and compared bit for bit."""

import ctypes
import hashlib
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import piezoid
from piezoid.errors import ParameterFileError
from piezoid.export.bundle import SAMPLES, SHIPPED, bundle, runtime_source
from piezoid.export.parameter_file import AxisParameters, Robustness, from_json, to_json
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.runtime.controller import Controller, Status
from piezoid.runtime.library import library
from piezoid.runtime.schema import PARAMETERS, TIP_PARAMETERS
from tests.export.stage import lateral, stage
from tests.runtime.compiler import PRECISION, STRICT, require_tool, run, write_files

DUMP = """
#include <stdio.h>
#include "piezo_params.h"
int main(void) {
    return fwrite(piezo_params, sizeof piezo_params, 1, stdout) == 1 ? 0 : 1;
}
"""


@cache
def stage_bundle():
    return bundle(stage())


def write_bundle(folder, files=None):
    return write_files(folder, files or stage_bundle())


def build(folder, *flags, main="example_main.c", out="example"):
    compiler = require_tool("cc", "gcc", "clang")
    sources = [str(folder / main), str(folder / "piezoid_runtime.c")]
    run(compiler, *flags, f"-I{folder}", *sources, "-o", str(folder / out))
    return str(folder / out)


@pytest.mark.parametrize(("precision", "optimisation"), [("double", "-O3"), ("float", "-O0")])
def test_a_fresh_build_gives_the_golden_answers_bit_for_bit(precision, optimisation, tmp_path):
    folder = write_bundle(tmp_path)
    program = build(folder, *STRICT, optimisation, *PRECISION[precision])
    with (folder / "golden.csv").open() as table:
        output = run(program, stdin=table)
    assert output == f"{3 * SAMPLES} samples, 0 differ\n"


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """Return the compiled example program and the lines of its table."""
    folder = write_bundle(tmp_path_factory.mktemp("example"))
    return build(folder, *STRICT), (folder / "golden.csv").read_text().splitlines(keepends=True)


def assert_program_fails(program, table, folder, match):
    (folder / "changed.csv").write_text(table)
    with (folder / "changed.csv").open() as changed, pytest.raises(AssertionError, match=match):
        run(program, stdin=changed)


@pytest.mark.parametrize("answer", [lambda v: np.nextafter(v, 99), lambda _: np.nan])
def test_a_differing_answer_is_detected(answer, example, tmp_path):
    """NaN compares unequal, but is neither greater nor smaller."""
    program, table = example
    cells = table[500].split(",")
    cells[3] = repr(float(answer(float(cells[3]))))
    changed = "".join([*table[:500], ",".join(cells), *table[501:]])
    assert_program_fails(program, changed, tmp_path, "1 differ")


def test_a_differing_status_is_printed_with_its_axis(example, tmp_path):
    program, table = example
    cells = table[1500].split(",")
    cells[4] = str(int(cells[4]) + 2)
    changed = "".join([*table[:1500], ",".join(cells) + "\n", *table[1501:]])
    message = rf"axis 1, sample 500: .* status {int(cells[4]) - 2}; expected .* status {cells[4]}"
    assert_program_fails(program, changed, tmp_path, message)


def test_an_unreadable_table_is_detected(example, tmp_path):
    golden = "".join(example[1])
    assert_program_fails(example[0], golden[:20000] + "?" + golden[20000:], tmp_path, "line")


@pytest.mark.parametrize("rows", [0, 1, 257, SAMPLES, 2 * SAMPLES, 3 * SAMPLES - 1])
@pytest.mark.parametrize("cut", [0, 7])
def test_a_truncated_table_is_detected(rows, cut, example, tmp_path):
    program, lines = example
    assert_program_fails(
        program, "".join(lines[: rows + 1]) + lines[rows + 1][:cut], tmp_path, "samples of"
    )


def test_an_empty_input_is_answered_with_the_command(example, tmp_path):
    assert_program_fails(example[0], "", tmp_path, r"run \./example < golden\.csv")


@pytest.mark.parametrize("precision", PRECISION)
def test_every_bit_of_the_header_is_that_of_the_packed_parameters(precision, tmp_path):
    folder = write_bundle(tmp_path)
    (folder / "dump.c").write_text(DUMP)
    program = build(folder, *STRICT, *PRECISION[precision], main="dump.c", out="dump")
    run("sh", "-c", f"{program} > {folder / 'dumped'}")
    packed = [bytes(library(precision).pack(axis.values)) for axis in stage().axes]
    assert (folder / "dumped").read_bytes() == b"".join(packed)


def test_the_bundle_has_the_installed_files_and_states_the_version():
    files = stage_bundle()
    assert set(files) == {*SHIPPED, "piezo_params.h", "golden.csv", "README.md"}
    assert all(files[name] == runtime_source(name) for name in SHIPPED)
    for name in ("piezo_params.h", "README.md"):
        text = stage_bundle()[name].decode()
        assert f"Written by piezoid {piezoid.__version__}. " in text


def test_a_runtime_of_another_schema_does_not_compile(tmp_path):
    folder = write_bundle(tmp_path)
    runtime = folder / "piezoid_runtime.h"
    runtime.write_text(runtime.read_text().replace("PZ_SCHEMA_VERSION 2", "PZ_SCHEMA_VERSION 3"))
    with pytest.raises(AssertionError, match="has schema version 2"):
        build(folder, "-std=c99")


@pytest.mark.parametrize(
    "pattern",
    [r"PZ_REAL\((3\.525)e-06\)", r"#else\n#define .*\n#define PIEZO_CHECKSUM_X 0x(....)"],
)
def test_an_edited_header_does_not_start(pattern, tmp_path):
    folder = write_bundle(tmp_path)
    header = folder / "piezo_params.h"
    text = header.read_text()
    match = re.search(pattern, text)
    assert match is not None
    edited = "3.526" if match[1] == "3.525" else "0000"
    header.write_text(text[: match.start(1)] + edited + text[match.end(1) :])
    program = build(folder, *STRICT)
    with (folder / "golden.csv").open() as table, pytest.raises(AssertionError, match="checksum"):
        run(program, stdin=table)


HOSTILE = (
    "*/ int evil; /*", "line\nbreak", "back\\", "back\\\n", '"quote"', "tri??/graph??/", "\x00nul",
    "\u202eturned\u2066", "Ångström\u2028evil", "%s%n", '\\u0022evil', "#include <evil.h>\r#error",
    "| cell |\n# heading\n", "x" * 5000 + "*/ evil", "",
)  # fmt: skip


@pytest.mark.parametrize("text", HOSTILE, ids=ascii)
def test_a_hostile_text_adds_no_token_to_the_header_and_no_line_to_the_readme(text):
    tame = bundle(replace(stage("tame"), unshipped={"w": "tame"}))
    hostile = bundle(replace(stage(text), sources={text: text}, unshipped={text: text}))
    assert hostile.keys() == tame.keys()
    assert tokens(hostile["piezo_params.h"]) == tokens(tame["piezo_params.h"])
    for name in ("piezo_params.h", "README.md"):
        assert hostile[name].decode("ascii").count("\n") == tame[name].decode("ascii").count("\n")
        assert not set(hostile[name]) - set(range(32, 127)) - {10}
    assert {n: c for n, c in hostile.items() if n not in TEXT_FILES} == {
        n: c for n, c in tame.items() if n not in TEXT_FILES
    }


TEXT_FILES = ("piezo_params.h", "README.md")


def tokens(header):
    """Return the tokens of a header without comments and without the digest."""
    code = re.sub(rb"/\*.*?\*/", b" ", header, flags=re.S)
    assert b"/*" not in code
    return re.sub(rb"sha256:[0-9a-f]{64}", b"", code).split()


def test_all_hostile_texts_at_once_compile_and_give_the_golden_answers(tmp_path):
    text = "".join(HOSTILE)
    files = bundle(replace(stage(text), sources={text: text}, unshipped={t: t for t in HOSTILE}))
    folder = write_bundle(tmp_path, files)
    program = build(folder, *STRICT, "-Wcomment", "-Wtrigraphs")
    with (folder / "golden.csv").open() as table:
        assert run(program, stdin=table).endswith(" 0 differ\n")


NO_NAMES = ("x\n", "X", "1x", "x-y", "ä", "x y", "x;", "x" * 17, "../x")


@pytest.mark.parametrize("axis", [*HOSTILE, *NO_NAMES], ids=ascii)
def test_an_axis_that_is_no_identifier_in_c_is_refused(axis):
    with pytest.raises(ParameterFileError, match="an axis is named"):
        AxisParameters(axis=axis, values=lateral("mpi_dob"))


def is_stated(parameter, axis):
    """Return whether the header states a parameter: zeros of a tip axis may be left out."""
    is_for_axis = axis.method == "rst" or parameter.name not in TIP_PARAMETERS
    return is_for_axis or axis.values[parameter.name].any()


def test_the_header_explains_every_parameter_in_full():
    header = stage_bundle()["piezo_params.h"].decode()
    for parameter in PARAMETERS:
        assert re.fullmatch(r"[ -~]{5,90}", parameter.meaning)
        assert "*/" not in parameter.meaning
        axes = [a for a in stage().axes if is_stated(parameter, a)]
        assert axes
        assert header.count(f"/* {parameter.meaning}") >= len(axes)
    assert ".method = PZ_METHOD_MPI_DOB," in header


def test_the_golden_table_contains_faults_and_keeps_the_limits():
    rows = [line.split(",") for line in stage_bundle()["golden.csv"].decode().splitlines()[1:]]
    table = np.array([[float(cell) for cell in row] for row in rows])
    assert len(table) == 3 * SAMPLES
    status_bits = np.bitwise_or.reduce(table[:, 4].astype(np.int64))
    assert status_bits & Status.BAD_REFERENCE
    assert status_bits & Status.BAD_MEASUREMENT
    assert np.isfinite(table[:, 3]).all()
    assert np.abs(table[:, 3]).max() <= 10
    assert np.ptp(table[:SAMPLES, 3]) > 5


def readme() -> str:
    return stage_bundle()["README.md"].decode()


def code_block(section, text=None):
    """Return the indented lines of a section of the bundle's README."""
    lines = (text or readme()).partition(section)[2].partition("\n## ")[0]
    return "\n".join(re.findall(r"^    (.*)", lines, flags=re.M))


def test_the_commands_of_the_readme_build_and_pass_the_test(tmp_path):
    require_tool("cc")
    folder = write_bundle(tmp_path)
    assert run("sh", "-ec", code_block("## 1."), cwd=folder).endswith(" 0 differ\n")


@pytest.mark.parametrize("axes", ["x", "z", "zx"])
def test_the_calls_of_the_readme_compile(axes, tmp_path):
    files = bundle(replace(stage(), axes=tuple(map(stage().axis, axes))))
    folder = write_bundle(tmp_path, files)
    (folder / "calls.c").write_text(
        DECLARATIONS + code_block("## 2.", files["README.md"].decode()) + "\n"
    )
    run(require_tool("cc", "gcc", "clang"), *STRICT, "-fsyntax-only", str(folder / "calls.c"))


DECLARATIONS = """#include "piezo_params.h"
pz_real dac_voltage_V(void), read_sensor(void);
void write_dac(pz_real), stop_with(const char *), stop_timer(void);
void power_up(void), on_timer(void);
static pz_real target;
"""
SATURATED = """
#include <stdio.h>
static int outputs, has_stopped;
static pz_real low_V = PZ_REAL(1e9), high_V = PZ_REAL(-1e9);
pz_real dac_voltage_V(void) { return piezo_params[0].voltage_offset_V; }
pz_real read_sensor(void) {
    const pz_parameters *p = &piezo_params[0];
    return outputs == 0 ? p->displacement_offset_m : PZ_REAL(2) * p->displacement_maximum_m;
}
void write_dac(pz_real voltage_V) {
    low_V = voltage_V < low_V ? voltage_V : low_V;
    high_V = voltage_V > high_V ? voltage_V : high_V;
    ++outputs;
}
void stop_with(const char *name) { printf("invalid: %s", name); }
void stop_timer(void) { has_stopped = 1; }
int main(void) {
    power_up();
    while (!has_stopped && outputs < 1000) {
        on_timer();
    }
    printf("%d outputs, %d", outputs, high_V - low_V <= piezo_params[0].lsb_V);
    return 0;
}
"""


def test_the_program_of_the_readme_stops_at_a_saturated_sensor_without_motion(tmp_path):
    axis = stage().axis("x").with_values({"blind_samples": 30})
    files = bundle(replace(stage(), axes=(axis,)))
    text = files["README.md"].decode()
    power_up = code_block("## 2.", text).partition("void on_timer")[0]
    on_timer = code_block("## 4.", text)
    source = "#include <math.h>\n" + DECLARATIONS + power_up + "\n" + on_timer + SATURATED
    folder = write_bundle(tmp_path, files)
    (folder / "calls.c").write_text(source)
    program = build(folder, *STRICT, main="calls.c", out="calls")
    assert run(program) == "30 outputs, 1"  # one sound reading, 29 before the latch


def test_the_readme_states_limits_codes_and_bytes():
    limits = {"voltage_minimum_V": -0.0004, "voltage_maximum_V": 9.79156, "lsb_V": 20 / 65536}
    axis = stage().axis("x").with_values(limits)
    text = bundle(replace(stage(), axes=(axis,)))["README.md"].decode()
    assert "| -0.0003051758 to 9.79126 | 0.00030517578125 | -1 to 32084 |" in text
    unrounded = replace(stage(), axes=(axis.with_values({"lsb_V": 0.0}),))
    assert "| -0.0004 to 9.79156 | 0 |  |" in bundle(unrounded)["README.md"].decode()
    for precision in ("float", "double"):
        assert f"{library(precision).state_size} ({precision})" in text
    assert ctypes.sizeof(ctypes.c_float) == library("float").code.pz_size_of_real()


def table_row(text, heading, axis):
    """Return the cells of an axis in the table with this heading, by column."""
    names, _, *rows = text[text.index(heading) :].partition("\n\n")[0].splitlines()
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in (names, *rows)]
    return dict(zip(cells[0], next(row for row in cells[1:] if row[0] == axis), strict=True))


LOOPS = "| axis | delay margin |"
ROBUSTNESS = Robustness(
    delay_margin_s=2.82e-4,
    transient_s=1.3e-3,
    guaranteed_error_m=2e-6,
    reference_slew_m_per_s=3.39e-3,
)


def test_the_readme_states_margin_guarantee_and_transient_of_the_parameter_file():
    axis = replace(stage().axis("x"), robustness=ROBUSTNESS)
    file = from_json(to_json(replace(stage(), axes=(axis,))), "params.json")
    assert file.axes[0].robustness == ROBUSTNESS
    row = table_row(bundle(file)["README.md"].decode(), LOOPS, "x")
    assert row["delay margin"] == "282 us"
    assert row["safe delay"] == "85 us"
    assert row["guaranteed error"] == "2.00 um up to 3.39 mm/s"
    assert row["transient"] == "1.3 ms"
    assert file.axes[0].with_values({"lsb_V": 0.0}).robustness is None


@pytest.mark.parametrize(
    ("step_m", "error_m", "cell", "sentences"),
    [
        (0.0, None, "none", []),
        (1e-7, None, "no useful bound", ["`UNCERTIFIED`", "For x, this limit exceeds"]),
        (1e-7, 2e-6, "2.00 um up to 3.39 mm/s", ["`UNCERTIFIED`", "guaranteed error of section"]),
    ],
)
def test_the_readme_has_only_the_sentences_of_its_guarantee(step_m, error_m, cell, sentences):
    axis = stage().axis("x").with_values({"certified_step_m": step_m})
    axis = replace(axis, robustness=replace(ROBUSTNESS, guaranteed_error_m=error_m))
    text = bundle(replace(stage(), axes=(axis,)))["README.md"].decode()
    assert table_row(text, LOOPS, "x")["guaranteed error"] == cell
    for sentence in ("`UNCERTIFIED`", "For x, this limit exceeds", "guaranteed error of section"):
        assert (sentence in text) == (sentence in sentences)


def test_the_readme_states_the_lag_of_the_observer_model():
    axis = stage().axis("x")
    order, rate_Hz = int(axis.values["observer_order"]), axis.sampling_rate_Hz
    A, B, C = (axis.values[f"observer_{name}"] for name in "ABC")
    x, readings_m = np.zeros(order), []
    for sample in range(4000):
        readings_m.append(C[:order] @ x)
        x = A[:order, :order] @ x + B[:order] * sample
    lag_s = (3999 - readings_m[-1] / float(axis.values["gain_m_per_V"])) / rate_Hz
    stated, unit = table_row(readme(), LOOPS, "x")["lag"].split()
    assert float(stated) * {"us": 1e-6, "ms": 1e-3}[unit] == pytest.approx(lag_s, rel=0.01)


def outermost_branch(axis, voltage_V, side):
    """Return the operator's displacement on a ramp whose plays begin at one end, without creep."""
    knots = int(axis.values["knot_count"])
    plays = slice(int(axis.values["play_count"]))
    threshold_V = axis.values["play_threshold_V"][plays]
    operator = ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=threshold_V, weight=axis.values["play_weight_m_per_V"][plays]
        ),
        dead_zones=DeadZones(
            threshold=axis.values["knot_m"][:knots], weight=axis.values["knot_weight"][:knots]
        ),
        voltage_offset_V=float(axis.values["voltage_offset_V"]),
    )
    memory_V = voltage_V[0] - operator.voltage_offset_V + side * threshold_V
    return operator.run(voltage_V, memory_V)[0]


CREEP = 1.01  # of the stage, after all its creep


@pytest.mark.parametrize("polarity", [1, -1])
@pytest.mark.parametrize("low_V", [-10.0, 0.0])
def test_the_readme_states_the_readings_at_the_ends_of_the_output_range(low_V, polarity):
    """At 0 V, a stage at rest may lie anywhere between both branches."""
    axis = stage().axis("x").with_values({"voltage_minimum_V": low_V, "polarity": polarity})
    text = bundle(replace(stage(), axes=(axis,)))["README.md"].decode()
    row = table_row(text.replace("\n  |", "\n|"), "| axis | reading at the lowest output |", "x")
    assert row["centre of the model"] == "0 m at 0 V"
    high_V = float(axis.values["voltage_maximum_V"])
    for column, voltage_V, sides in (
        ("reading at the lowest output", low_V, (1, -1) if low_V == 0.0 else (1,)),
        ("at the highest output", high_V, (-1,)),
    ):
        ends_m = [
            polarity * factor * outermost_branch(axis, np.array([voltage_V]), side)[0]
            for side in sides
            for factor in (1.0, CREEP)
        ]
        stated_m = [float(end) for end in row[column].removesuffix(" m").split(" to ")]
        assert stated_m == pytest.approx([min(ends_m), max(ends_m)], rel=1e-3)


@pytest.mark.parametrize("low_V", [-5.0, 0.0, 2.0])
def test_the_start_of_the_readme_lies_inside_and_its_jump_bounds_the_first_output(low_V):
    limits = {"voltage_minimum_V": low_V, "reference_step_m": 1e-7, "lsb_V": 0.0}
    limits |= {"reference_minimum_m": max(low_V, -3.0) * 3.5e-6}
    axis = stage().axis("x").with_values(limits)
    row = table_row(bundle(replace(stage(), axes=(axis,)))["README.md"].decode(), LOOPS, "x")
    high_V = float(axis.values["voltage_maximum_V"])
    start_V = float(row["start"].removesuffix(" V"))
    assert low_V < start_V < high_V
    if low_V < 0.0:
        assert start_V == 0.0
    else:
        ramp_V = np.linspace(low_V, high_V, 4001)
        crept_m = np.outer([1.0, CREEP], outermost_branch(axis, ramp_V, -1))
        reading_m = crept_m.min(axis=0)
        inside_V = ramp_V[reading_m >= float(axis.values["reference_minimum_m"])][0]
        assert start_V == pytest.approx(inside_V + 0.05 * (high_V - low_V), abs=0.06)
    jump_V = float(row["jump"].removesuffix(" V"))
    for voltage_V in (low_V, high_V):
        for reading_m in np.linspace(-4e-5, 4e-5, 41):
            controller = Controller(axis.values)
            controller.start(voltage_V, reading_m)
            first_V = controller.step(reading_m, reading_m)
            assert abs(first_V - voltage_V) <= 1.05 * jump_V


@pytest.mark.parametrize(
    ("axes", "features", "others"),
    [
        ("x", ["displacement limits", "about a tip"], ["`trip_limit`", " axis: ", "`rst`: "]),
        ("z", ["`trip_limit`", "`rst`: "], ["displacement limits", " axis: ", "`blind_samples`"]),
        ("xz", ["displacement limits", "`trip_limit`", "Position axis: ", "Tip axis: "], ["skip"]),
    ],
)
def test_the_readme_leaves_out_what_concerns_no_axis(axes, features, others):
    file = replace(stage(), axes=tuple(map(stage().axis, axes)))
    text = bundle(file)["README.md"].decode()
    assert all(feature in text for feature in features)
    assert not any(other in text for other in others)
    assert not re.search(r"^@", text, flags=re.M)


@pytest.mark.parametrize(("axes", "is_tip"), [("x", False), ("z", True), ("xz", True)])
def test_a_saturated_current_is_never_hidden_from_a_tip(axes, is_tip):
    """A tip waits at NaN, and retracts at once from a current at its ceiling."""
    file = replace(stage(), axes=tuple(map(stage().axis, axes)))
    text = bundle(file)["README.md"].decode()
    assert ("Do not pass `NAN` at the highest code" in text) == is_tip
    assert ("Pass `NAN` also at the lowest and at the highest code" in text) == ("x" in axes)


def test_a_zero_lsb_is_explained_only_where_an_axis_has_none():
    assert "LSB of 0" not in readme()
    axis = stage().axis("x").with_values({"lsb_V": 0.0})
    text = bundle(replace(stage(), axes=(axis,)))["README.md"].decode()
    assert "LSB of 0" in text
    assert "two's-complement" not in text


def test_the_digests_of_the_readme_follow_from_its_instructions():
    parameters = to_json(stage())
    stated = json.loads(parameters)["digest"].removeprefix("sha256:")
    zeroed = parameters.replace(stated.encode(), b"0" * 64)
    source = runtime_source("piezoid_runtime.h") + runtime_source("piezoid_runtime.c")
    for content in (zeroed, source):
        assert hashlib.sha256(content).hexdigest() in readme()


def test_the_readme_states_the_guards_of_every_axis_and_the_set_point_of_a_tip():
    x, _, z = stage().axes
    x = x.with_values({"stuck_samples": 20, "stuck_voltage_V": 0.2, "blind_samples": 2000})
    text = bundle(replace(stage(), axes=(x, z)))["README.md"].decode()
    assert "| x | 20 | 0.2 | 2000 (0.1 s) | -4e-05 to 4e-05 |  |  |  |  |" in text
    assert "| z | 0 | 0 |  |  | 5 | 0 | 0 | -9 |" in text
    assert "| 1e-11 to 2e-08 A, set point 1e-09 |" in text
