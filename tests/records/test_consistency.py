"""Recordings of one stage are consistent, or refused with the likely reason."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from benchmarks.outsiders.simulators import load_simulator as simulator
from benchmarks.zoo.stages import draw_stage as drawn
from benchmarks.zoo.stages import stage
from piezoid.errors import RecordingError
from piezoid.records.checks.consistency import check_consistency, copies, refuse_inconsistent
from piezoid.records.collection import collect
from piezoid.records.frames import from_arrays
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import read_lab
from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.write import write_campaign
from tests.records.messy.outcomes import write_messy
from tests.records.messy.writers import NAMES, SAMPLES, columns, lines, scaled, text


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        (
            "kilovolts.csv",
            r"1000 times more\. Likely cause: another unit of the drive.*voltage = 1000",
        ),
        (
            "monitor.csv",
            r"15\.0 times more\. Likely cause: the drive is the output of a monitor \(1/15\)",
        ),
        ("polarity.csv", r"opposite sign\. Likely cause: opposite polarity of drive or sensor"),
    ],
)
def test_an_inconsistent_file_is_refused_with_the_likely_reason(name, reason, tmp_path):
    text(lines())(tmp_path / "clean.csv")
    recordings = collect([tmp_path / "clean.csv", write_messy(name, tmp_path)]).recordings
    with pytest.raises(RecordingError) as caught:
        refuse_inconsistent(recordings)
    assert re.search(reason, str(caught.value), re.DOTALL)
    assert f'file = "{name}"' in caught.value.remedy


def test_the_file_with_the_implausible_gain_is_named(tmp_path):
    scaled(1, 0.5, 0.5, written="{:.6f}".format)(tmp_path / "clean.csv")
    scaled(1, 1, 1000, written="{:.6f}".format)(tmp_path / "wide.csv")
    recordings = collect([tmp_path / "clean.csv", tmp_path / "wide.csv"]).recordings
    with pytest.raises(RecordingError, match="another unit of the displacement") as caught:
        refuse_inconsistent(recordings)
    assert 'file = "wide.csv"' in caught.value.remedy


def test_an_ambiguous_monitor_is_not_guessed(tmp_path):
    text(lines())(tmp_path / "clean.csv")
    scaled(1, 1 / 15, 1.17, written="{:.6f}".format)(tmp_path / "check.csv")
    with pytest.raises(
        RecordingError, match=r"a monitor \(1/15 or 1/20\) or the command"
    ) as caught:
        refuse_inconsistent(collect([tmp_path / "clean.csv", tmp_path / "check.csv"]).recordings)
    assert "scale = { voltage = ... }" in caught.value.remedy


def test_a_chirp_and_a_small_loop_are_consistent_with_a_sweep(rng):
    rate_Hz = 10000.0
    time_s = np.arange(0, 3, 1 / rate_Hz)
    drives_V = {
        "sweep": 50 + 40 * signal.sawtooth(2 * np.pi * time_s, 0.5),
        "chirp": 50 + 10 * signal.chirp(time_s, 1, 3, 2000),
        "fast": 50 + 5 * np.sin(2 * np.pi * 700 * time_s),
        "small": 50 + np.sin(2 * np.pi * 5 * time_s),
    }
    pole = 2 * np.pi * 650
    mode = signal.bilinear([pole**2], [1, pole / 30, pole**2], rate_Hz)
    recordings = []
    for name, drive_V in drives_V.items():
        response_m = 2e-7 * (drive_V[0] + signal.lfilter(*mode, drive_V - drive_V[0]))
        noisy_m = response_m + rng.normal(0, 2e-9, len(time_s))
        recording = from_arrays(
            voltage_V=drive_V, displacement_m=noisy_m, sampling_rate_Hz=rate_Hz, name=name
        )
        recordings.append(recording)
    refuse_inconsistent(recordings)
    assert not copies(recordings)


def test_slow_lines_of_noise_do_not_contradict_the_gain():
    """The drive history of a stage can add slow lines of opposite sign."""
    rng = np.random.default_rng(0)
    phase = 2 * np.pi * np.arange(4000) / 4000
    lines = np.arange(1, 61)
    waves = np.cos(lines[:, None] * phase + rng.uniform(0, 2 * np.pi, (60, 1)))
    slow_V, fast_V = 0.8 * waves[:4].sum(axis=0), waves[4:].sum(axis=0)
    sweep_V = 30 * signal.sawtooth(2 * phase, 0.5)
    readings = {"sweep": (sweep_V, sweep_V), "noise": (slow_V + fast_V, fast_V - 3.0 * slow_V)}
    recordings = [
        from_arrays(
            voltage_V=drive_V,
            displacement_m=1e-6 * response + rng.normal(0, 1e-9, 4000),
            sampling_rate_Hz=2500.0,
            name=name,
        )
        for name, (drive_V, response) in readings.items()
    ]
    refuse_inconsistent(recordings)


def test_repeated_runs_of_a_drive_are_no_copies(tmp_path, rng):
    repeated = columns() + np.outer(rng.normal(0, 0.003, SAMPLES), [0, 0, 1])
    text(lines())(tmp_path / "first.csv")
    text(lines(table=repeated))(tmp_path / "second.csv")
    assert not copies(collect([tmp_path / "first.csv", tmp_path / "second.csv"]).recordings)


def test_a_closed_loop_segment_does_not_contradict_the_gain(tmp_path):
    rows = write_messy("held.csv", tmp_path).read_text().splitlines()
    text(rows[:600])(tmp_path / "approach.csv")
    text([rows[0], *rows[600:]])(tmp_path / "hold.csv")
    recordings = collect([tmp_path / "approach.csv", tmp_path / "hold.csv"]).recordings
    assert [p.quantity for r in recordings for p in r.statements] == ["closed_loop"]
    refuse_inconsistent(recordings)


def test_counts_mixed_with_metres_are_refused_with_the_line(tmp_path):
    text(lines())(tmp_path / "known.csv")
    text(lines(names=(*NAMES[:2], "position [LSB]")))(tmp_path / "raw.csv")
    paths = [tmp_path / "known.csv", tmp_path / "raw.csv"]
    with pytest.raises(RecordingError, match=r"displacement of raw.csv is in counts") as caught:
        refuse_inconsistent(collect(paths).recordings)
    assert 'file = "raw.csv"\nscale = {' in caught.value.remedy
    kinds = [s.quantity for s in inspect_files(paths)[1].statements]
    assert "mixed_units" in kinds


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
