"""`piezoid diagnose` of files without a drive beside a displacement: a refusal that says so."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.errors import ExcitationError
from piezoid.records.collection import collect

NO_DRIVE = "Time (s)\tZ (m)"
SPECTROSCOPY = "Z rel (m)\tCurrent (A)"


def write(place: Path, experiment: str, names: str) -> Path:
    """Write a Nanonis file of two columns: the first rises, the second wanders."""
    rows = np.column_stack([np.linspace(0.0, 10.0, 400), np.linspace(0.0, 1e-9, 400)])
    lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
    place.write_text(
        f"Experiment\t{experiment}\t\nBias>Bias (V)\t0E+0\t\n\n[DATA]\n"
        + "\n".join([names, *lines])
        + "\n"
    )
    return place


@pytest.mark.parametrize(
    ("experiment", "names", "told"),
    [("history", NO_DRIVE, "only displacement"), ("Z spectroscopy", SPECTROSCOPY, "no recording")],
)
def test_a_file_without_a_drive_is_refused_with_what_is_missing(
    tmp_path: Path, experiment: str, names: str, told: str
) -> None:
    held = collect([write(tmp_path / "drift.dat", experiment, names)])
    with pytest.raises(ExcitationError, match=f"{told}.*a drive voltage and a displacement"):
        diagnose(held.recordings)


def test_an_axis_that_is_not_there_is_refused_by_its_name() -> None:
    held = collect([Path("datasets/x_check.csv")])
    with pytest.raises(ExcitationError, match="displacement of axis y"):
        diagnose(held.recordings, axis="y")
