"""Recordings that somebody else's simulator made: what they are is not to be refused."""

from pathlib import Path

import pytest

from benchmarks.outsiders.simulators import simulator
from piezoid.records.comparison import misfits
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import read_lab


@pytest.mark.parametrize("seed", [171, 180])
def test_a_quick_multisine_about_a_mode_does_not_contradict_the_sign_of_a_sweep(
    seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without a window its lines leak into the lowest ones, with the sign that they have."""
    monkeypatch.chdir(tmp_path)
    made = simulator("alder")
    made.campaigns.write_stage(seed, tmp_path, made.library)
    files = sorted(tmp_path.glob("*.csv"))
    assert len(files) > 1
    assert misfits(ingest_all(files, read_lab(tmp_path / "lab.toml"))) == ()
