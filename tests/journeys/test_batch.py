"""`piezoid batch` with real schedulers and workers, a killed worker, and a second run."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from piezoid.errors import PiezoidError
from tests.journeys.command import PIEZOID, piezoid

COUNT = 3
CONSTANT_DRIVE = 2  # index of the stage whose drive never changes


def write_stages(folder: Path, count: int = COUNT) -> Path:
    """Write stages with three cycles of a loop of two plays, without a controller."""
    phase = 2 * np.pi * np.arange(240) / 80
    drive = 5 - 5 * np.cos(phase)
    for serial in range(count):
        stage_folder = folder / f"unit-{serial}"
        stage_folder.mkdir(parents=True)
        memory, displacement_um = 0.0, np.empty(len(drive))
        for k, u in enumerate(drive):
            memory = max(u - 1.5, min(u + 1.5, memory))
            displacement_um[k] = (2 + 0.01 * serial) * u + 0.6 * memory
        displacement_um += 0.002 * np.random.default_rng(serial).standard_normal(
            len(displacement_um)
        )
        driven = 0 * drive if serial == CONSTANT_DRIVE else drive
        rows = [
            f"{k / 80:.4f},{u:.5f},{y:.5f}"
            for k, (u, y) in enumerate(zip(driven, displacement_um, strict=True))
        ]
        heading = "time [s],voltage [V],position [um]"
        (stage_folder / "sweep.csv").write_text("\n".join((heading, *rows)) + "\n")
        (stage_folder / "lab.toml").write_text(f'[rig]\nname = "unit {serial}"\n')
    return folder


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list["subprocess.Popen[bytes]"]]]:
    """Start a scheduler and two workers without nannies, each in its process."""
    scheduler_file = tmp_path / "scheduler.json"
    common = ("--scheduler-file", str(scheduler_file), "--no-dashboard")
    module = (sys.executable, "-W", "ignore", "-m")
    without_output = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    start = lambda *words: subprocess.Popen([*module, *words], cwd=tmp_path, **without_output)  # noqa: E731
    scheduler = start(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common
    )
    workers = [
        start("distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1", *common)
        for _ in range(2)
    ]
    while not scheduler_file.exists() or not scheduler_file.read_text().strip().endswith("}"):
        time.sleep(0.05)
    yield json.loads(scheduler_file.read_text())["address"], workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


def states(out: Path) -> dict[str, str]:
    record = json.loads((out / "batch.json").read_bytes())
    return {stage["name"]: stage["state"] for stage in record["stages"]}


def test_a_killed_worker_loses_no_result_and_a_second_run_repeats_nothing(tmp_path, cluster):
    address, workers = cluster
    folder, out = write_stages(tmp_path / "night"), tmp_path / "out"
    process = subprocess.Popen(
        [*PIEZOID, "batch", folder, "--out", out, "--scheduler", address, "--quiet"],
        stderr=subprocess.PIPE,
    )
    while process.poll() is None and not list(out.glob("stages/*")):
        time.sleep(0.02)
    os.kill(workers[0].pid, signal.SIGKILL)
    _, message = process.communicate(timeout=300)
    assert process.returncode == 1, message  # the drive of one stage never changes
    assert b"Traceback" not in message
    state_of = states(out)
    assert len(state_of) == COUNT
    assert state_of.pop(f"unit-{CONSTANT_DRIVE}") == "refused"
    assert set(state_of.values()) == {"passed"}

    modified_ns = {path: path.stat().st_mtime_ns for path in out.glob("stages/*/*")}
    second_run = piezoid("batch", folder, "--out", out, "--scheduler", address, "--json")
    assert json.loads(second_run.stdout)["passed"] is False
    assert modified_ns == {path: path.stat().st_mtime_ns for path in out.glob("stages/*/*")}

    rows = pq.read_table(out / "parameters.parquet").to_pylist()
    assert [row["stage"] for row in rows] == [f"unit-{k}" for k in range(COUNT)]
    gains = [row["sensitivity_m_per_V"] for row in rows if row["applies"]]
    assert gains == sorted(gains)  # as simulated
    assert all(sum(row["play_weight_m_per_V"]) > 0 for row in rows if row["applies"])

    (folder / "unit-0" / "lab.toml").write_text('[rig]\nname = "another"\n')
    refused = piezoid("batch", folder, "--out", out, "--scheduler", address)
    assert refused.exit_code == 2
    assert "--force" in refused.output
    assert modified_ns == {path: path.stat().st_mtime_ns for path in out.glob("stages/*/*")}


def test_an_empty_folder_and_a_foreign_result_folder_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    without_stages = piezoid("batch", tmp_path / "empty", "--out", tmp_path / "out").exception
    assert isinstance(without_stages, PiezoidError)
    assert without_stages.exit_status == 3
    assert "lab.toml" in str(without_stages)
    write_stages(tmp_path / "night")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    foreign = piezoid("batch", tmp_path / "night", "--out", tmp_path / "mine")
    assert foreign.exit_code == 2
    assert "has no manifest" in foreign.output


def test_an_interrupted_batch_ends_with_one_message(tmp_path):
    """A second run continues: tests/cli/test_batch_stages.py."""
    folder, out = write_stages(tmp_path / "night", count=1), tmp_path / "out"
    words = [*PIEZOID, "batch", folder, "--out", out, "--workers", "1", "--quiet"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE)
    while process.poll() is None and not out.exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130
    assert message == b"interrupted: no file is left half written\n"
