"""The newcomer's notebook runs as it stands, from a CSV file to a closed loop."""

import re
import runpy
from pathlib import Path

import matplotlib as mpl
import pytest

import piezoid_datasets

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]

NOTEBOOK = Path(__file__).with_name("notebook.py")
MOST_LINES, ROWS = 25, 2500


def test_a_notebook_of_twenty_five_lines_goes_from_a_csv_file_to_a_closed_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    code = NOTEBOOK.read_text(encoding="utf-8")
    assert len(code.splitlines()) <= MOST_LINES
    assert not re.search(r"piezoid\.\w+ import|import piezoid\.", code)
    for name, recording in (("sweep", "x_sweep.csv"), ("check", "x_check.csv")):
        rows = (piezoid_datasets.FOLDER / recording).read_text().splitlines()[: ROWS + 1]
        (tmp_path / f"{name}.csv").write_text("\n".join(rows) + "\n")
    rig, _, _ = piezoid_datasets.LAB.read_text().partition("[[recording]]")
    (tmp_path / "lab.toml").write_text(rig)
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    runpy.run_path(str(NOTEBOOK))
    printed = capsys.readouterr().out
    unseen, closed = (
        float(re.search(rf"{word}: ([\d.]+) ", printed)[1])  # type: ignore[index]
        for word in ("unseen", "closed loop")
    )
    assert unseen < 0.5  # percent; the stage's loop is open by 5
    assert closed < 20.0  # nm; the sensor's noise is 9
    assert len(list(tmp_path.glob("*.png"))) == 5
