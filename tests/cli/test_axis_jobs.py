"""A stage calibrated in several processes has the bytes of a single process."""

import json
from pathlib import Path

import numpy as np
import pytest

from piezoid.calibration.calibrate import AxisJob, jobs_of
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


def write_butterfly(path: Path, bottom_V: float) -> Path:
    """Write a noisy response that falls and rises, which the model class soon rejects."""
    noise_um = 0.3 * np.random.default_rng(0).standard_normal(SAMPLES)
    displacement_um = 0.1 * (DRIVE_V - bottom_V) ** 2 + noise_um
    lines = [f"V{path.stem} [V],{path.stem} [um]"]
    lines += [f"{u:.5f},{y:.6f}" for u, y in zip(DRIVE_V, displacement_um, strict=True)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_lab(folder: Path, axes: str) -> Lab:
    (folder / "lab.toml").write_text(LAB + "".join(ENTRY.format(axis=axis) for axis in axes))
    return read_lab(folder / "lab.toml")


def test_two_processes_write_the_bytes_of_a_single_process(tmp_path):
    files = [write_butterfly(tmp_path / "x.csv", 5.0), write_butterfly(tmp_path / "y.csv", 4.0)]
    write_lab(tmp_path, "xy")
    lab = tmp_path / "lab.toml"
    messages: list[str] = []
    serial = calibrate(files, lab, lambda _: None, 1)
    parallel = calibrate(files, lab, messages.append, 2)
    model = json.loads(serial.files["model.json"])
    assert (model["stage"], sorted(model["axes"])) == ("two butterflies", ["x", "y"])
    diagnosis = json.loads(serial.files["diagnosis.json"])
    assert (diagnosis["axis"], set(diagnosis["axes"])) == ("x", {"y"})
    assert dict(parallel.files) == dict(serial.files)
    assert any("axis x: " in text for text in messages)
    assert any("axis y: " in text for text in messages)


@pytest.mark.parametrize(
    ("processes", "axes", "threads"), [(1, "x", 1), (2, "x", 2), (2, "xy", 1), (5, "xy", 2)]
)
def test_idle_cores_become_threads_of_the_axes(tmp_path, processes, axes, threads):
    lab = write_lab(tmp_path, axes)
    recordings = collect([write_butterfly(tmp_path / f"{axis}.csv", 5.0) for axis in axes], lab)
    _, jobs = jobs_of(recordings, lab, processes)
    shares = [(job.axis, job.threads) for job in jobs if isinstance(job, AxisJob)]
    assert shares == [(axis, threads) for axis in axes]
    assert len(jobs) == len(axes)
