"""Jobs in worker processes: what comes back is what one process would have given."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pytest

from piezoid.errors import TemplateError
from piezoid.numerics.arrays import Array
from piezoid_cli.batch_cluster import cluster_client
from piezoid_cli.workers import map_jobs, worker_pool

HERE = os.getpid()


@dataclass(frozen=True, kw_only=True)
class Job:
    """Numbers to add."""

    numbers: Array
    parent: int = HERE
    refused: str = ""
    dies: bool = False


@dataclass(frozen=True, kw_only=True)
class Sum:
    """What came of it, and where."""

    words: MappingProxyType[str, float]
    numbers: Array
    is_here: bool


def add(job: Job, report: Callable[[str], None]) -> Sum:
    report(f"adding {len(job.numbers)} numbers")
    is_here = os.getpid() == job.parent
    if job.dies and not is_here:
        os.kill(os.getpid(), signal.SIGKILL)
    if job.refused:
        raise TemplateError(job.refused, needed="9 dB", remedy="Ask for less.", excess_dB=3.0)
    if is_here and len(job.numbers) == 99:
        time.sleep(1.0)  # the workers take the others meanwhile
    words = MappingProxyType({"sum": float(job.numbers.sum())})
    return Sum(words=words, numbers=job.numbers, is_here=is_here)


def load() -> None:
    """Have nothing to load."""


def frozen(count: int) -> Array:
    numbers = np.random.default_rng(count).standard_normal((count, 2))
    numbers.setflags(write=False)
    return numbers


def run(*jobs: Job, workers: int, report: Callable[[str], None] = lambda _: None) -> list[Sum]:
    with worker_pool(workers, load) as pool:
        if pool is not None:
            pool._executor.submit(os.getpid).result()  # it is there
        return map_jobs(add, jobs, report, pool=pool, cost=lambda job: float(len(job.numbers)))


def test_results_are_those_of_one_process_in_the_order_of_the_jobs() -> None:
    jobs = [Job(numbers=frozen(count)) for count in (5, 99, 0, 7)]
    alone, together = run(*jobs, workers=0), run(*jobs, workers=2)
    for one, other in zip(alone, together, strict=True):
        assert (one.words, one.numbers.tobytes()) == (other.words, other.numbers.tobytes())
        assert not other.numbers.flags.writeable
    assert [one.is_here for one in together] == [False, True, False, False]


@pytest.mark.parametrize("workers", [0, 1])
def test_the_first_refusal_in_order_is_raised_with_its_numbers(workers: int) -> None:
    jobs = [
        Job(numbers=frozen(3)),
        Job(numbers=frozen(8), refused="missed by 3 dB"),
        Job(numbers=frozen(99), refused="missed by more"),
    ]
    with pytest.raises(TemplateError, match="missed by 3 dB") as error:
        run(*jobs, workers=workers)
    assert error.value.numbers == {"excess_dB": 3.0}
    assert error.value.exit_status == 4


def test_a_killed_worker_costs_time_and_no_result() -> None:
    jobs = [Job(numbers=frozen(count), dies=count == 7) for count in (5, 99, 7, 8)]
    found = run(*jobs, workers=1)
    assert [one.words["sum"] for one in found] == [float(job.numbers.sum()) for job in jobs]


def test_jobs_given_after_a_worker_was_killed_are_done_in_this_process() -> None:
    jobs = [Job(numbers=frozen(count)) for count in (3, 99, 4)]
    with worker_pool(1, load) as pool:
        assert pool is not None
        assert pool.submit(add, Job(numbers=frozen(1), dies=True), 0).exception() is not None
        found = map_jobs(add, jobs, print, pool=pool, cost=lambda job: float(len(job.numbers)))
    assert [one.is_here for one in found] == [True, True, True]


def test_a_worker_that_cannot_load_costs_time_and_no_result() -> None:
    with worker_pool(1, sys.exit) as pool:
        jobs = [Job(numbers=frozen(3)), Job(numbers=frozen(99))]
        found = map_jobs(add, jobs, print, pool=pool, cost=lambda job: float(len(job.numbers)))
    assert [one.is_here for one in found] == [True, True]


def test_what_workers_do_is_reported() -> None:
    said: list[str] = []
    run(Job(numbers=frozen(8)), Job(numbers=frozen(99)), workers=1, report=said.append)
    assert any("adding 8 numbers" in text for text in said)
    assert any("adding 99 numbers" in text for text in said)


@pytest.mark.parametrize("after_s", [0.0, 0.2, 0.6, 1.5])
def test_ctrl_c_ends_this_process_and_its_workers_with_status_130(
    after_s: float, tmp_path: Path
) -> None:
    (tmp_path / "jobs.py").write_text("""
import time
def wait(job, report):
    time.sleep(600)
def load():
    pass
""")
    (tmp_path / "run.py").write_text("""
from piezoid_cli.interrupt import install, interruptible
from piezoid_cli.workers import map_jobs, worker_pool
from jobs import load, wait
if __name__ == "__main__":
    install()
    with interruptible():
        print("working", flush=True)
        with worker_pool(2, load) as pool:
            map_jobs(wait, [1, 2, 3], print, pool=pool, cost=float)
""")
    process = subprocess.Popen(
        [sys.executable, "run.py"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    assert process.stdout is not None
    process.stdout.readline()
    time.sleep(after_s)
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all of them
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert said == b"interrupted: no file is left half written\n"
    for _ in range(100):
        if not in_session(process.pid):
            break
        time.sleep(0.05)
    assert not in_session(process.pid)


def in_session(leader: int) -> list[str]:
    """Return what still runs of a session."""
    listed = ["ps", "-o", "pid=,args=", "-s", str(leader)]
    return subprocess.run(listed, capture_output=True, text=True, check=False).stdout.split()


def _blocked_signals(*_: object) -> set[int]:
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, ()))


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals here")
def test_ctrl_c_in_a_terminal_does_not_reach_the_workers_of_a_batch() -> None:
    with cluster_client("", 1) as client:
        assert signal.SIGINT not in _blocked_signals()
        (blocked,) = client.run(_blocked_signals).values()
    assert signal.SIGINT in blocked


def test_no_thread_of_a_pool_outlives_it():
    # A thread that closed its pipe while Python ended printed a traceback below a refusal.
    with pytest.raises(ZeroDivisionError), worker_pool(1, load):
        raise ZeroDivisionError
    kinds = {type(thread).__name__ for thread in threading.enumerate()}
    assert "_ExecutorManagerThread" not in kinds
