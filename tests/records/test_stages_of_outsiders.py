"""Recordings that somebody else's simulator made: what they are is not to be refused."""

from pathlib import Path

import pytest

from benchmarks.outsiders.simulators import simulator
from benchmarks.zoo.stages import drawn, stage
from piezoid.records.checks.consistency import check_consistency
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign


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
    assert check_consistency(collect(files, read_lab(tmp_path / "lab.toml")).recordings) == []


@pytest.mark.parametrize("seed", [52711, 52712])
def test_a_long_hold_contradicts_the_gain_of_no_sweep(seed: int, tmp_path: Path) -> None:
    """About another mean than that under the window, two offsets were taken for a gain."""
    made = draw_campaign(seed, truth="bouc_wen", plans=("sweep", "long_hold"))
    write_campaign(made, tmp_path)
    files = sorted((tmp_path / "recordings").glob("*.csv"))
    assert (
        check_consistency(collect(files, read_lab(tmp_path / "recordings/lab.toml")).recordings)
        == []
    )


def test_creep_through_minutes_of_rest_between_two_moves_contradicts_no_sweep(
    tmp_path: Path,
) -> None:
    """Its lowest frequencies said -49 um per volt where the stage moves 2.8 um."""
    write_campaign(drawn(stage("bouc_wen", "single", 0, 2_400_000)), tmp_path)
    files = sorted((tmp_path / "recordings").glob("*.csv"))
    assert (
        check_consistency(collect(files, read_lab(tmp_path / "recordings/lab.toml")).recordings)
        == []
    )


def test_two_holds_of_nearly_one_level_contradict_no_sweep(tmp_path: Path) -> None:
    """Between them the stage moves by its memory; the range of the readings is its own."""
    write_campaign(draw_campaign(60026), tmp_path)
    files = sorted((tmp_path / "recordings").glob("*.csv"))
    assert len(files) > 2
    assert (
        check_consistency(collect(files, read_lab(tmp_path / "recordings/lab.toml")).recordings)
        == []
    )
