"""The decoupling matrix in params.json, header and README."""

import struct
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ParameterFileError
from piezoid.export.bundle import bundle
from piezoid.export.parameter_file import Decoupled, digest_of, from_json, to_json
from tests.export.stage import stage
from tests.runtime.compiler import STRICT, require_tool, run, write_files

MATRIX = np.array([[1.0, -0.125, 1 / 3], [0.1, 1.0, 2e-7], [0.0, 1e-300, 1.0]])
FILE = replace(stage(), decoupled=Decoupled(axes=("x", "y", "z"), matrix=MATRIX))
MAIN = """
#include <stdio.h>
#include "piezo_params.h"
int main(void) {
    return fwrite(piezo_decoupling, sizeof piezo_decoupling, 1, stdout) == 1 ? 0 : 1;
}
"""


def test_a_matrix_is_read_from_params_json_to_the_last_bit():
    read = from_json(to_json(FILE), "params.json")
    assert read.decoupled is not None
    assert read.decoupled.axes == ("x", "y", "z")
    np.testing.assert_array_equal(read.decoupled.matrix, MATRIX)
    assert digest_of(read) == digest_of(FILE) != digest_of(stage())


def test_a_matrix_of_another_shape_is_refused():
    with pytest.raises(ValueError, match="matrix"):
        Decoupled(axes=("x", "y"), matrix=MATRIX)
    broken = to_json(FILE).replace(b'"decoupled"', b'"decoupler"')
    with pytest.raises(ParameterFileError):
        from_json(broken, "params.json")


def test_the_header_contains_the_matrix_to_the_last_bit(tmp_path):  # type: ignore[no-untyped-def]
    write_files(tmp_path, bundle(FILE))
    (tmp_path / "dump.c").write_text(MAIN)
    compiler = require_tool("cc", "gcc", "clang")
    run(compiler, *STRICT, f"-I{tmp_path}", str(tmp_path / "dump.c"), "-o", str(tmp_path / "dump"))

    output = subprocess.run([str(tmp_path / "dump")], capture_output=True, check=True).stdout
    assert struct.unpack("9d", output) == tuple(MATRIX.ravel())


def test_the_readme_explains_the_matrix_only_if_there_is_one():
    readme = bundle(FILE)["README.md"].decode()
    assert "references and their readings by the matrix" in readme
    assert "| x | 1 | -0.125 | 0.333333 |" in readme
    assert "piezo_decoupling" not in bundle(stage())["README.md"].decode()
