"""`piezoid fit --stream` writes the folder of a stage without ever holding its recording."""

from pathlib import Path

from piezoid_cli.fit import calibrate_streamed
from tests.journeys.test_readme import ROOT


def test_a_fit_in_blocks_writes_model_and_report_and_says_what_it_leaves_out(
    tmp_path: Path,
) -> None:
    files = [ROOT / "datasets" / "x_sweep.csv", ROOT / "datasets" / "x_check.csv"]
    told: list[str] = []
    found = calibrate_streamed(files, None, tmp_path / "new", told.append)
    assert {"model.json", "report.html"} <= set(found.files)
    assert "diagnosis.json" not in found.files
    assert "no diagnosis" in found.model["x"].verdict.remarks[0]
    assert b"not diagnosed" in found.files["report.html"]
    assert found.controllers.reason
    assert told[0] == "reading x_sweep.csv"
    assert not list((tmp_path / "new").iterdir())
    quality = found.model["x"].quality
    assert quality.held_out_kind == "other recordings"
    assert quality.held_out_rms_percent < 0.25
