"""A user whose stage does what is in no catalogue is told so first, and sees where it lives."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from piezoid_cli.main import app
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("plays_alone", "one_order")]


def test_a_tone_of_no_grid_is_told_first_with_its_frequency_and_drawn(tmp_path: Path) -> None:
    campaign = draw_campaign(91, plans=("sweep", "check"), uncatalogued={"tone": 0.6})
    write_campaign(campaign, tmp_path)
    made = tmp_path / "recordings"
    files = [str(file) for file in sorted(made.glob("*.csv"))]
    out = tmp_path / "diag"
    done = CliRunner().invoke(
        app, ["diagnose", *files, "--lab", str(made / "lab.toml"), "--out", str(out)]
    )
    assert done.exit_code == 0, done.output
    record = json.loads((out / "diagnosis.json").read_text())
    (finding,) = record["findings"]
    assert (finding["effect"], finding["coordinate"]) == ("something_else", "frequency")
    assert finding["size"]["value"] == pytest.approx(6e6 * campaign.rig.stroke_m, rel=0.05)
    assert f"{finding['parameters']['frequency_Hz']:.5g} Hz" in " ".join(done.output.split())
    assert record["unexplained"]["p_value"] < 0.05
    assert "something_else" not in {absent["effect"] for absent in record["not_detected"]}
    page = (out / "diagnosis.html").read_text()
    assert "residual against the part of a period" in page
