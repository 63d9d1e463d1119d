"""The bundled recordings agree with their manifest and their seed."""

import hashlib
import tomllib

import numpy as np
import pytest

from piezoid_datasets import FOLDER, MANIFEST, recordings, stage_files
from piezoid_datasets.virtual_lab import bundled

LARGEST_BYTES, ALL_BYTES = 800_000, 3_000_000
ENTRIES = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))["recording"]
LATERAL = [entry for entry in ENTRIES if "displacement" in entry["columns"]]


def test_the_bundled_files_are_those_of_seed_and_manifest():
    files = bundled.rebuild()
    assert sorted(files) == sorted(path.name for path in stage_files())
    assert all(path.read_bytes() == files[path.name] for path in stage_files())
    assert {path.name for path in FOLDER.glob("*.csv")} == {path.name for path in recordings()}
    assert {path.name for path in FOLDER.glob("*.dat")} == {stage_files()[-1].name}
    assert sum(path.stat().st_size for path in stage_files()) < ALL_BYTES


def test_the_manifest_names_the_seed_and_size_of_creep_that_were_used():
    manifest = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
    assert manifest["seed"] == bundled.SEED
    assert manifest["effects"] == {"creep_per_decade": bundled.CREEP_PER_DECADE}
    assert manifest["noise_rms_m"] == bundled.RIG.noise_rms_m
    assert manifest["stroke_m"] == bundled.RIG.stroke_m
    assert manifest["stroke_y_m"] == bundled.RIG_Y.stroke_m
    assert (manifest["seed_y"], manifest["seed_z"]) == (bundled.SEED_Y, bundled.SEED_Z)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry["file"])
def test_the_manifest_describes_the_file(entry):
    content = (FOLDER / str(entry["file"])).read_bytes()
    header, *lines = content.decode().splitlines()
    columns = entry["columns"]
    assert isinstance(columns, dict)
    assert hashlib.sha256(content).hexdigest() == entry["sha256"]
    assert len(content) < LARGEST_BYTES
    assert header.split(",") == list(columns.values())
    assert len(lines) == entry["rows"]


@pytest.mark.parametrize("entry", LATERAL, ids=lambda entry: entry["file"])
def test_the_time_column_ticks_at_the_stated_rate(entry):
    table = np.loadtxt(FOLDER / str(entry["file"]), delimiter=",", skiprows=1)
    rate_Hz = entry["sampling_rate_Hz"]
    assert isinstance(rate_Hz, float)
    assert np.allclose(np.diff(table[:, 0]) * rate_Hz, 1.0, atol=1e-9)
    assert table[:, 1].min() >= 0.0
    assert table[:, 1].max() <= 10.0
