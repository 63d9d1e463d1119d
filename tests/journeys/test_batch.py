"""`piezoid batch`: real schedulers and workers, one of them killed, and a second start."""

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

from tests.journeys.command import PIEZOID, started

COUNT = 3
DEAD = 2  # the stage whose drive never changes


def write_night(folder: Path, count: int = COUNT) -> Path:
    """A stage: three cycles of a loop made of two plays; no controller is asked for."""
    phase = 2 * np.pi * np.arange(240) / 80
    drive = 5 - 5 * np.cos(phase)
    for serial in range(count):
        place = folder / f"unit-{serial}"
        place.mkdir(parents=True)
        memory, shape = 0.0, np.empty(len(drive))
        for k, u in enumerate(drive):
            memory = max(u - 1.5, min(u + 1.5, memory))
            shape[k] = (2 + 0.01 * serial) * u + 0.6 * memory
        shape += 0.002 * np.random.default_rng(serial).standard_normal(len(shape))
        driven = 0 * drive if serial == DEAD else drive
        rows = [
            f"{k / 80:.4f},{u:.5f},{y:.5f}"
            for k, (u, y) in enumerate(zip(driven, shape, strict=True))
        ]
        heading = "time [s],voltage [V],position [um]"
        (place / "sweep.csv").write_text("\n".join((heading, *rows)) + "\n")
        (place / "lab.toml").write_text(f'[rig]\nname = "unit {serial}"\n')
    return folder


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[tuple[str, list["subprocess.Popen[bytes]"]]]:
    """A scheduler and two workers without a nurse, each a process of its own."""
    told = tmp_path / "scheduler.json"
    common = ("--scheduler-file", str(told), "--no-dashboard")
    module = (sys.executable, "-W", "ignore", "-m")
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    begin = lambda *words: subprocess.Popen([*module, *words], cwd=tmp_path, **quiet)  # noqa: E731
    scheduler = begin(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", *common
    )
    workers = [
        begin("distributed.cli.dask_worker", "--no-nanny", "--nthreads", "1", *common)
        for _ in range(2)
    ]
    while not told.exists() or not told.read_text().strip().endswith("}"):
        time.sleep(0.05)
    yield json.loads(told.read_text())["address"], workers
    for process in (*workers, scheduler):
        process.kill()
        process.wait()


def states(out: Path) -> dict[str, str]:
    record = json.loads((out / "batch.json").read_bytes())
    return {stage["name"]: stage["state"] for stage in record["stages"]}


def test_a_killed_worker_loses_nothing_and_a_second_start_does_nothing_again(
    tmp_path: Path, cluster: tuple[str, list["subprocess.Popen[bytes]"]]
) -> None:
    address, workers = cluster
    night, out = write_night(tmp_path / "night"), tmp_path / "out"
    process = subprocess.Popen(
        [*PIEZOID, "batch", night, "--out", out, "--scheduler", address, "--quiet"],
        stderr=subprocess.PIPE,
    )
    while process.poll() is None and not list(out.glob("stages/*")):
        time.sleep(0.02)
    os.kill(workers[0].pid, signal.SIGKILL)
    _, said = process.communicate(timeout=300)
    assert process.returncode == 1, said  # one stage's drive never changes
    assert b"Traceback" not in said
    held = states(out)
    assert len(held) == COUNT
    assert held.pop(f"unit-{DEAD}") == "refused"
    assert set(held.values()) == {"passed"}

    before = {p: p.stat().st_mtime_ns for p in out.glob("stages/*/*")}
    again = started("batch", night, "--out", out, "--scheduler", address, "--json")
    assert json.loads(again.stdout)["passed"] is False
    assert before == {p: p.stat().st_mtime_ns for p in out.glob("stages/*/*")}

    rows = pq.read_table(out / "parameters.parquet").to_pylist()
    assert [row["stage"] for row in rows] == [f"unit-{k}" for k in range(COUNT)]
    gains = [row["sensitivity_m_per_V"] for row in rows if row["applies"]]
    assert gains == sorted(gains)  # as they were made
    assert all(sum(row["play_weight_m_per_V"]) > 0 for row in rows if row["applies"])

    (night / "unit-0" / "lab.toml").write_text('[rig]\nname = "another"\n')
    refused = started("batch", night, "--out", out, "--scheduler", address)
    assert refused.returncode == 2
    assert "--force" in refused.stderr
    assert before == {p: p.stat().st_mtime_ns for p in out.glob("stages/*/*")}


def test_a_batch_of_nothing_and_a_folder_of_something_else_are_refused(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    nothing = started("batch", tmp_path / "empty", "--out", tmp_path / "out")
    assert nothing.returncode == 3
    assert "lab.toml" in nothing.stderr
    write_night(tmp_path / "night")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.tex").write_text("precious")
    mine = started("batch", tmp_path / "night", "--out", tmp_path / "mine")
    assert mine.returncode == 2
    assert "has no manifest" in mine.stderr


def test_a_batch_that_was_interrupted_goes_on_with_the_stages_that_are_missing(
    tmp_path: Path,
) -> None:
    """A worker that was killed outright, and stages that are not done again: above."""
    night, out = write_night(tmp_path / "night", count=1), tmp_path / "out"
    words = [*PIEZOID, "batch", night, "--out", out, "--workers", "1", "--quiet"]
    process = subprocess.Popen(words, stderr=subprocess.PIPE)
    while process.poll() is None and not out.exists():
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said == b"interrupted: no file is left half written\n"
    again = started("batch", night, "--out", out, "--workers", "1", "--quiet")
    assert again.returncode == 0, again.stderr
    assert states(out) == {"unit-0": "passed"}
