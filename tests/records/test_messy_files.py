"""Messy files are read with the true values, or refused for the true reason."""

import contextlib
import re
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import LabFileError, RecordingError
from piezoid.records.collection import collect
from piezoid.records.frames import from_frame, to_frame
from piezoid.records.lab import Lab, read_lab
from piezoid.records.lab_draft import draft_lab
from piezoid.records.readers import READERS
from tests.records.messy.outcomes import FILES, inspect_messy, table, write_messy
from tests.records.messy.samples import formats_table, reader_of, samples
from tests.records.messy.writers import (
    EVERY,
    NAMES,
    VOLTAGE_V,
    POSITION_um,
    RATE_Hz,
    columns,
    lines,
    text,
)
from tests.records.tables import lab_with

DOCUMENT = Path(__file__).parents[2] / "docs" / "messy_files.md"


def lab_for(name: str, folder: Path, entry: str) -> Lab:
    (folder / "lab.toml").write_text(f'[[recording]]\nfile = "{name}"\n{entry}')
    return read_lab(folder / "lab.toml")


def assert_true_values(path: Path, lab: Lab, true_rows: np.ndarray, breaks: int) -> None:
    recording = collect([path], lab)[0]
    assert recording.sampling_rate_Hz == RATE_Hz
    assert len(recording.breaks) == breaks
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V[true_rows], atol=2e-5)
    np.testing.assert_allclose(
        recording.displacement_m(), 1e-6 * POSITION_um[true_rows], atol=2e-11
    )


@pytest.mark.parametrize("messy", FILES, ids=lambda messy: messy.name)
def test_a_file_gives_the_true_values_or_is_refused(messy, tmp_path):
    """The document lists the statements and the reasons."""
    messy.write(tmp_path / messy.name)
    if len(messy.true_rows) and not messy.entry:
        with contextlib.suppress(RecordingError):
            assert_true_values(tmp_path / messy.name, Lab(), messy.true_rows, messy.breaks)
    elif messy.entry:
        refusal = inspect_messy(messy, tmp_path)[0].refusal
        if refusal and messy.name != "strange_mark.csv":  # the keys that mend it stand in it
            keys = re.findall(r"^(reverse|separator|decimal|scale)\b", messy.entry, re.MULTILINE)
            assert all(key in refusal for key in keys)
        lab = lab_for(messy.name, tmp_path, messy.entry)
        assert_true_values(tmp_path / messy.name, lab, EVERY, 0)
        inspections = inspect_messy(messy, tmp_path, messy.entry)
        assert {s.quantity for i in inspections for s in i.statements} <= {"copy", "transposed"}


def test_the_document_lists_the_outcomes_and_every_reader_has_a_sample(tmp_path):
    assert table() in DOCUMENT.read_text()
    assert formats_table() in DOCUMENT.read_text()
    read = {reader_of(tmp_path, name, write).name for name, write in samples().items()}
    assert read == {reader.name for reader in READERS}


def test_segments_of_several_rates_keep_their_clock_and_seconds_of_the_file(tmp_path):
    path = write_messy("two_rates.csv", tmp_path)
    slow, fast = collect([path]).recordings
    assert (slow.sampling_rate_Hz, fast.sampling_rate_Hz) == (256, 2048)
    assert slow.samples + fast.samples == 4096
    time_s = np.genfromtxt(path, delimiter=",", skip_header=1)[:, 0]
    # The sum of the steps is the duration, except for the step between the two segments.
    assert slow.duration_s + fast.duration_s == pytest.approx(np.ptp(time_s), abs=1 / 256)
    lab = lab_for(path.name, tmp_path, "start_s = 8.5\nstop_s = 8.75\n")
    fast = collect([path], lab)[0]
    assert fast.sampling_rate_Hz == 2048
    assert fast.duration_s == pytest.approx(0.25, abs=1e-3)


def test_an_entry_about_a_missing_file_is_named(tmp_path):
    text(lines())(tmp_path / "sweep.csv")
    (tmp_path / "lab.toml").write_text('[[recording]]\nfile = "swep.csv"\n')
    lab = read_lab(tmp_path / "lab.toml")
    with pytest.raises(LabFileError, match=r"'swep.csv'.*'sweep.csv' has a similar name"):
        collect([tmp_path / "sweep.csv"], lab)
    (tmp_path / "swep.csv").write_text("it is there, and not asked for today")
    assert collect([tmp_path / "sweep.csv"], lab).recordings


def test_reversed_rows_are_refused_without_a_time_column(tmp_path):
    rows = lines()
    text([rows[0], *rows[:0:-1]])(tmp_path / "run.csv")
    entry = {"columns": {"voltage": 2, "displacement": 3}, "sampling_rate_Hz": 1000.0}
    with pytest.raises(RecordingError, match="the newest row is the first"):
        collect([tmp_path / "run.csv"], lab_with(**entry))[0]
    turned = collect([tmp_path / "run.csv"], lab_with(**entry, reverse=True))[0]
    np.testing.assert_allclose(turned.voltage_V(), VOLTAGE_V)


def test_a_decimal_mark_of_a_binary_file_is_refused(tmp_path):
    np.save(tmp_path / "run.npy", columns())
    lab = lab_for("run.npy", tmp_path, 'decimal = ","\n')
    with pytest.raises(LabFileError, match=r"decimal of run.npy is declared, which is npy"):
        collect([tmp_path / "run.npy"], lab)


def test_counts_of_a_known_converter_suggest_their_scale(tmp_path):
    lab_toml = (
        "[amplifier]\ngain_V_per_V = 15\n[acquisition]\ndac_bits = 16\ninput_range_V = [-10, 10]\n"
    )
    text(lines(names=("time [s]", "drive [counts]", "position [um]")))(tmp_path / "run.csv")
    (tmp_path / "lab.toml").write_text(lab_toml)
    recording = collect([tmp_path / "run.csv"], read_lab(tmp_path / "lab.toml"))[0]
    (problem,) = recording.statements
    assert "scale = { voltage = 0.000305175781 }" in problem.text
    np.testing.assert_allclose(recording.voltage_V(), VOLTAGE_V)  # the counts themselves
    assert recording.counted == ("voltage",)
    frame = to_frame(recording)
    assert list(frame) == ["time_s", "voltage_x [counts]", "displacement_x_m"]
    assert from_frame(frame).counted == ("voltage",)
    assert "voltage of x: 10 to 90 counts" in draft_lab([tmp_path / "run.csv"], tmp_path).text


def test_a_clock_in_counts_is_refused(tmp_path):
    text(lines(names=("time [ticks]", *NAMES[1:])))(tmp_path / "run.csv")
    with pytest.raises(RecordingError, match="only drive and displacement may be in counts"):
        collect(
            [tmp_path / "run.csv"],
            lab_with(
                columns={"time": 1, "voltage": 2, "displacement": 3}, units={"time": "ticks"}
            ),
        )[0]
