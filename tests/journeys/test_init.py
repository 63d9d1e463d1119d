"""`piezoid init`: the first lab.toml states the interpretation of the files and reads them."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import piezoid_datasets
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.records.lab_draft import draft_lab
from tests.journeys.command import run

HOSTILE = ('po"s [um]', "pos\\n [um]", "pos # [um]", "pos\u202e [um]", "pos 'x' [um]")


def sweep(path: Path, heading: str = "pos [um]", drive: str = "voltage [V]") -> Path:
    time_s = np.arange(200) / 100
    rows = np.column_stack([time_s, np.sin(time_s), np.cos(time_s)])
    quoted = ",".join('"' + name.replace('"', '""') + '"' for name in (drive, heading))
    lines = [f"{t:.2f},{u:.5f},{y:.5f}" for t, u, y in rows]
    path.write_text(f"time [s],{quoted}\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_lab_file_reads_recordings_as_without_it(tmp_path):
    files = piezoid_datasets.recordings()[:2]
    status, output = run("init", *files, "--out", tmp_path / "lab.toml")
    assert status == 0, output
    assert "x_sweep.csv: text table" in output
    declared = collect(files, read_lab(tmp_path / "lab.toml")).recordings
    for original, with_lab in zip(collect(files).recordings, declared, strict=True):
        assert original.axis == with_lab.axis
        assert original.sampling_rate_Hz == with_lab.sampling_rate_Hz
        assert np.array_equal(original.voltage_V(), with_lab.voltage_V())
        assert np.array_equal(original.displacement_m(), with_lab.displacement_m())


def test_unknown_properties_of_the_laboratory_are_comments(tmp_path):
    draft = draft_lab([sweep(tmp_path / "a.csv")], tmp_path)
    tables = tomllib.loads(draft.text)
    assert not any(tables[table] for table in ("rig", "amplifier", "sensor", "acquisition"))
    completed = re.sub(r"^# (\w+ = [^#\n]*).*$", r"\1", draft.text, flags=re.MULTILINE)
    (tmp_path / "lab.toml").write_text(completed)
    assert read_lab(tmp_path / "lab.toml").amplifier.gain_V_per_V == 15


@pytest.mark.parametrize("heading", HOSTILE)
def test_a_hostile_heading_is_quoted(tmp_path, heading):
    path = sweep(tmp_path / "a.csv", heading)
    draft = draft_lab([path], tmp_path)
    (tmp_path / "lab.toml").write_text(draft.text, encoding="utf-8")
    assert not draft.incomplete
    assert np.array_equal(
        collect([path], read_lab(tmp_path / "lab.toml"))[0].displacement_m(),
        collect([path])[0].displacement_m(),
    )


def test_a_repeated_heading_is_referred_to_by_number(tmp_path):
    path = sweep(tmp_path / "a.csv")
    path.write_text(path.read_text().replace("\n", ",\n").replace(",\n", ',"pos [um]"\n', 1))
    draft = draft_lab([path], tmp_path)
    assert tomllib.loads(draft.text)["recording"][0]["columns"]["displacement_x"] == 3
    (tmp_path / "lab.toml").write_text(draft.text)
    assert collect([path], read_lab(tmp_path / "lab.toml"))[0].samples == 200


def test_an_ambiguous_file_becomes_an_entry_to_complete(tmp_path):
    path = sweep(tmp_path / "a.csv", "pos")
    status, output = run("init", path, "--out", tmp_path / "lab.toml")
    assert status == 3
    assert "to complete" in output
    text = (tmp_path / "lab.toml").read_text()
    assert "without a unit" in text
    assert "recording" not in tomllib.loads(text)
    block = text[text.index("# [[recording]]") :]
    (tmp_path / "lab.toml").write_text(
        re.sub("^# ", "", block, flags=re.MULTILINE).replace(
            'displacement = "..."', 'displacement = "um"', 1
        )
    )
    assert (
        float(np.ptp(collect([path], read_lab(tmp_path / "lab.toml"))[0].displacement_m())) < 3e-6
    )


def test_an_entry_to_complete_proposes_the_axis_of_the_other_files(tmp_path):
    known, unclear = sweep(tmp_path / "a.csv", "pos_z [um]"), sweep(tmp_path / "b.csv", "pos")
    text = draft_lab([known, unclear], tmp_path).text
    block = text[text.index("# [[recording]]") :]
    assert 'axis = "z"' in block
    assert 'displacement = "pos"' in block


def test_an_existing_lab_file_is_kept_unless_forced(tmp_path):
    path = sweep(tmp_path / "a.csv")
    lab = tmp_path / "lab.toml"
    lab.write_text("precious")
    for words in ((), ("--force",)):
        status, output = run("init", path, "--out", lab, *words)
        assert status == 2
        assert "--force" in output
        assert lab.read_text() == "precious"
    lab.unlink()
    run("init", path, "--out", lab)
    lab.write_text(lab.read_text() + "# edited\n")
    assert run("init", path, "--out", lab)[0] == 2
    assert run("init", path, "--out", lab, "--force", "--quiet") == (0, "")
    assert "# edited" not in lab.read_text()
    assert read_lab(lab).recordings[0].file == "a.csv"


def test_files_are_relative_to_the_folder_of_the_lab_file(tmp_path):
    (tmp_path / "data").mkdir()
    (tmp_path / "rig").mkdir()
    path = sweep(tmp_path / "data" / "a.csv")
    draft = draft_lab([path], tmp_path / "rig")
    (tmp_path / "rig" / "lab.toml").write_text(draft.text)
    lab = read_lab(tmp_path / "rig" / "lab.toml")
    assert lab.recordings[0].file == "../data/a.csv"
    assert len(lab.entries_of(path)) == 1


def test_a_symbolic_link_to_itself_becomes_an_entry_to_complete(tmp_path):
    loop = tmp_path / "loop.csv"
    loop.symlink_to(loop)
    draft = draft_lab([loop], tmp_path)
    assert draft.incomplete == ("loop.csv",)
    assert "levels of symbolic links" in draft.text
