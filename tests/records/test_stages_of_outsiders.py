"""Recordings of independent simulators are consistent."""

from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.outsiders.simulators import load_simulator as simulator
from benchmarks.zoo.stages import draw_stage as drawn
from benchmarks.zoo.stages import stage
from piezoid.records.checks.consistency import check_consistency
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign


def assert_consistent(folder: Path) -> None:
    files = sorted(folder.glob("*.csv"))
    assert len(files) > 1
    assert check_consistency(collect(files, read_lab(folder / "lab.toml")).recordings) == []


def test_a_fast_multisine_does_not_contradict_the_sign_of_a_sweep(tmp_path, monkeypatch):
    """Without a window the lines of the multisine leak into the lowest frequencies."""
    monkeypatch.chdir(tmp_path)
    outsider = simulator("alder")
    outsider.campaigns.write_stage(171, tmp_path, outsider.library)
    assert_consistent(tmp_path)


CAMPAIGNS: dict[str, Callable[[], Campaign]] = {
    # With another mean than that of the window, two offsets look like a gain.
    "a long hold": lambda: draw_campaign(52711, truth="bouc_wen", plans=("sweep", "long_hold")),
    # Its lowest frequencies give -49 um/V for a stage of 2.8 um.
    "creep between two moves": lambda: drawn(stage("bouc_wen", "single", 0, 2_400_000)),
    # Between the holds the stage moves by its memory.
    "two holds of nearly one level": lambda: draw_campaign(60026),
}


@pytest.mark.parametrize("draw", CAMPAIGNS.values(), ids=CAMPAIGNS)
def test_slow_recordings_do_not_contradict_the_gain_of_a_sweep(draw, tmp_path):
    write_campaign(draw(), tmp_path)
    assert_consistent(tmp_path / "recordings")
