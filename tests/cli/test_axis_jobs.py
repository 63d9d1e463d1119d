"""A stage done in several processes is the stage done in one, to the last byte.

Cores that no axis takes become threads of those that are there.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from piezoid.calibration.axis_jobs import AxisJob, jobs_of
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid_cli.calibration import calibrate

SAMPLES = 300
DRIVE_V = 10 * (1 - np.cos(2 * np.pi * np.arange(SAMPLES) / 100)) / 2
LAB = """
[rig]
name = "two butterflies"
[acquisition]
sampling_rate_Hz = 1000
"""
ENTRY = """
[[recording]]
file = "{axis}.csv"
axis = "{axis}"
columns = {{ voltage = 1, displacement = 2 }}
"""


def write_butterfly(place: Path, bottom_V: float) -> Path:
    """Write a noisy response that falls and rises: no class of ours, and soon told."""
    noise_um = 0.3 * np.random.default_rng(0).standard_normal(SAMPLES)
    displacement_um = 0.1 * (DRIVE_V - bottom_V) ** 2 + noise_um
    lines = [f"V{place.stem} [V],{place.stem} [um]"]
    lines += [f"{u:.5f},{y:.6f}" for u, y in zip(DRIVE_V, displacement_um, strict=True)]
    place.write_text("\n".join(lines) + "\n")
    return place


def write_lab(place: Path, axes: str) -> Lab:
    (place / "lab.toml").write_text(LAB + "".join(ENTRY.format(axis=axis) for axis in axes))
    return read_lab(place / "lab.toml")


def test_the_files_of_a_stage_are_the_same_bytes_for_one_and_for_two_processes(
    tmp_path: Path,
) -> None:
    files = [write_butterfly(tmp_path / "x.csv", 5.0), write_butterfly(tmp_path / "y.csv", 4.0)]
    write_lab(tmp_path, "xy")
    lab = tmp_path / "lab.toml"
    said: list[str] = []
    alone = calibrate(files, lab, lambda _: None, 1)
    together = calibrate(files, lab, said.append, 2)
    model = json.loads(alone.files["model.json"])
    assert (model["stage"], sorted(model["axes"])) == ("two butterflies", ["x", "y"])
    diagnosis = json.loads(alone.files["diagnosis.json"])
    assert (diagnosis["axis"], set(diagnosis["axes"])) == ("x", {"y"})  # the first at the top
    assert dict(together.files) == dict(alone.files)
    assert any("axis x: " in text for text in said)
    assert any("axis y: " in text for text in said)


@pytest.mark.parametrize(
    ("processes", "axes", "threads"), [(1, "x", 1), (2, "x", 2), (2, "xy", 1), (5, "xy", 2)]
)
def test_cores_that_no_axis_takes_help_those_that_are_there(
    tmp_path: Path, processes: int, axes: str, threads: int
) -> None:
    lab = write_lab(tmp_path, axes)
    held = collect([write_butterfly(tmp_path / f"{axis}.csv", 5.0) for axis in axes], lab)
    _, jobs = jobs_of(held, lab, processes)
    shares = [(job.axis, job.threads) for job in jobs if isinstance(job, AxisJob)]
    assert shares == [(axis, threads) for axis in axes]
    assert len(jobs) == len(axes)
