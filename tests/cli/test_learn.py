"""`piezoid learn` reads the files of a stage and writes tables."""

from dataclasses import replace

import numpy as np
import pytest

import piezoid
from piezoid.export.parameter_file import to_json
from piezoid.sealed_files import digest_of
from tests.cli.calls import invoke
from tests.runtime.compiler import SOURCE, require_tool, run
from tests.targets.known_inputs import exported
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

POINTS = 200


@pytest.fixture
def stage(tmp_path):
    model = replace(fitted(), controller_rate_Hz=RATE_Hz)
    piezoid.save(model, tmp_path / "model.json")
    file = replace(exported().file, sources={"model": digest_of(model)})
    (tmp_path / "params.json").write_bytes(to_json(file))
    turns = 2 * np.pi * np.arange(POINTS) / POINTS
    rows = [f"{k / RATE_Hz},{v:.9f}" for k, v in enumerate(2.39 + 3 * np.sin(turns))]
    (tmp_path / "sine.csv").write_text("\n".join(["time [s],wanted [um]", *rows, ""]))
    return tmp_path


def learn(stage, *words):
    return invoke("learn", stage, "--reference", stage / "sine.csv", *words)


def test_a_recorded_period_gives_the_next_table_for_firmware(stage):
    result = learn(stage, "--out", stage / "a")
    assert result.exit_code == 0, result.output
    previous = piezoid.load(stage / "a" / "learning.json")
    short_m = 0.98 * previous.wanted_m  # a stage with too small a gain
    rows = [f"{k / RATE_Hz},0.{k % 7},{1e6 * v:.9f}" for k, v in enumerate(short_m)]
    (stage / "seen.csv").write_text("\n".join(["time [s],voltage [V],position [um]", *rows, ""]))
    words = ("--table", stage / "a/learning.json", "--period", stage / "seen.csv")
    result = learn(stage, *words, "--out", stage / "b")
    assert result.exit_code == 0, result.output
    learned = piezoid.load(stage / "b" / "learning.json")
    assert learned.errors_m == pytest.approx(
        [0.02 * np.sqrt(np.mean(previous.wanted_m**2))], rel=0.1
    )
    assert 0.01 < np.ptp(learned.table_V - previous.table_V) < 0.5
    assert f"{learned.table_V[7]:.17g}" in (stage / "b" / "x_feedforward.h").read_text()
    program = stage / "one.c"
    program.write_text(
        '#include "x_feedforward.h"\n'
        "int main(void) { return sizeof pz_x_feedforward_V / sizeof(pz_real) == "
        "PZ_X_FEEDFORWARD_POINTS && pz_x_wanted_m[0] > PZ_REAL(2e-6) ? 0 : 1; }\n"
    )
    compiler = require_tool("cc", "gcc", "clang")
    command = [compiler, "-std=c99", f"-I{SOURCE}", f"-I{stage / 'b'}", str(program)]
    run(*command, "-o", str(stage / "one"))
    run(str(stage / "one"))


def test_an_open_loop_table_is_a_file_for_a_waveform_generator(stage):
    (stage / "lab.toml").write_text("[acquisition]\ndac_bits = 16\ninput_range_V = [-10, 10]\n")
    result = learn(stage, "--open-loop", "--out", stage / "wave")
    assert result.exit_code == 0, result.output
    code = np.frombuffer((stage / "wave" / "x_int16.bin").read_bytes(), dtype="<i2").astype(float)
    table = piezoid.load(stage / "wave" / "learning.json")
    np.testing.assert_allclose(code * 20 / 2**16, table.table_V, atol=20 / 2**16)
    assert 6e-6 / 4e-6 < np.ptp(table.table_V) < 6e-6 / 1.5e-6
    assert not table.closed_loop
