"""The table of `piezoid inspect` at different widths of the terminal."""

from itertools import pairwise
from pathlib import Path

import pytest

from piezoid_datasets import LAB
from tests.cli.calls import invoke

SWEEP = LAB.parent / "x_sweep.csv"


def inspected_lines(path: Path, columns: int) -> list[str]:
    return invoke("inspect", path, columns=columns).output.splitlines()


def test_headings_and_numbers_are_unbroken_at_eighty_columns():
    lines = inspected_lines(SWEEP, 80)
    (row,) = [line for line in lines if line.startswith("3 ")]
    for cell in ("displacement [um]", "displacement of x", "1.071 µm", "33.17 µm", "9.236 nm"):
        assert cell in row
    assert max(map(len, lines)) <= 80


def test_the_noise_of_a_clock_and_of_a_computed_ramp_is_no_rounding_error():
    (clock,) = [line for line in inspected_lines(SWEEP, 80) if line.startswith("1 ")]
    assert clock.split() == ["1", "time", "[s]", "time", "s", "0", "s", "14.35", "s"]
    ramp = inspected_lines(LAB.parent / "z_spectroscopy.dat", 80)
    assert next(line for line in ramp if line.startswith("1 ")).rstrip().endswith("759.8 pm")


@pytest.mark.parametrize("columns", [60, 70, 80, 200])
def test_no_text_is_truncated_at_any_width(tmp_path, columns):
    heading = "position_of_the_stage_behind_its_filter_um"
    path = tmp_path / "run.csv"
    rows = SWEEP.read_text().splitlines()[1:400]
    path.write_text("\n".join([f"time_s,drive_V,{heading}", *rows]))
    lines = inspected_lines(path, columns)
    (header,) = [line for line in lines if line.startswith("#")]
    edges = [header.index(name) for name in ("column", "is", "unit", "from", "to ", "noise")]
    table = lines[lines.index(header) + 1 :]
    cells = ["".join(line[a:b].strip() for line in table) for a, b in pairwise(edges)]
    assert heading in cells[0]
    assert "32.31" in cells[4]
