"""The table of `piezoid inspect`: words stay whole, numbers stay on one line, nothing is lost."""

from itertools import pairwise
from pathlib import Path

import pytest
from typer.testing import CliRunner

from piezoid_cli.main import app
from piezoid_datasets import LAB

SWEEP = LAB.parent / "x_sweep.csv"


def shown(path: Path, columns: int) -> list[str]:
    done = CliRunner(env={"COLUMNS": str(columns)}).invoke(app, ["inspect", str(path)])
    return done.output.splitlines()


def test_no_heading_and_no_number_is_broken_at_eighty_columns() -> None:
    lines = shown(SWEEP, 80)
    (row,) = [line for line in lines if line.startswith("3 ")]
    for whole in ("displacement [um]", "displacement of x", "1.071 µm", "33.17 µm", "9.236 nm"):
        assert whole in row
    assert max(map(len, lines)) <= 80


def test_a_clock_has_no_noise_of_picoseconds_and_a_computed_ramp_none_of_rounding() -> None:
    (clock,) = [line for line in shown(SWEEP, 80) if line.startswith("1 ")]
    assert clock.split() == ["1", "time", "[s]", "time", "s", "0", "s", "14.35", "s"]
    ramp = shown(LAB.parent / "z_spectroscopy.dat", 80)
    assert next(line for line in ramp if line.startswith("1 ")).rstrip().endswith("759.8 pm")


@pytest.mark.parametrize("columns", [60, 70, 80, 200])
def test_nothing_is_cut_off_at_any_width(tmp_path: Path, columns: int) -> None:
    heading = "position_of_the_stage_behind_its_filter_um"
    place = tmp_path / "run.csv"
    rows = SWEEP.read_text().splitlines()[1:400]
    place.write_text("\n".join([f"time_s,drive_V,{heading}", *rows]))
    lines = shown(place, columns)
    (top,) = [line for line in lines if line.startswith("#")]
    edges = [top.index(name) for name in ("column", "is", "unit", "from", "to ", "noise")]
    table = lines[lines.index(top) + 1 :]
    cells = ["".join(line[a:b].strip() for line in table) for a, b in pairwise(edges)]
    assert heading in cells[0]
    assert "32.31" in cells[4]
