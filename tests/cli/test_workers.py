"""Jobs in worker processes give the results of a single process."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import pytest

from piezoid.errors import TemplateError
from piezoid.numerics.arrays import Array
from piezoid_cli.batch_cluster import cluster_client
from piezoid_cli.workers import map_jobs, worker_pool

PARENT = os.getpid()


@dataclass(frozen=True, kw_only=True)
class Job:
    """Numbers to add."""

    numbers: Array
    parent: int = PARENT
    refused: str = ""
    dies: bool = False


@dataclass(frozen=True, kw_only=True)
class Sum:
    """Result of a job, and whether this process computed it."""

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
        time.sleep(1.0)  # meanwhile the workers take the other jobs
    words = MappingProxyType({"sum": float(job.numbers.sum())})
    return Sum(words=words, numbers=job.numbers, is_here=is_here)


def load() -> None:
    """Load nothing."""


def random_numbers(count: int) -> Array:
    numbers = np.random.default_rng(count).standard_normal((count, 2))
    numbers.setflags(write=False)
    return numbers


def run(*jobs: Job, workers: int, report: Callable[[str], None] = lambda _: None) -> list[Sum]:
    with worker_pool(workers, load) as pool:
        if pool is not None:
            pool._executor.submit(os.getpid).result()  # wait for a worker
        return map_jobs(add, jobs, report, pool=pool, cost=lambda job: float(len(job.numbers)))


def test_workers_give_the_results_of_a_single_process():
    jobs = [Job(numbers=random_numbers(count)) for count in (5, 99, 0, 7)]
    serial, parallel = run(*jobs, workers=0), run(*jobs, workers=2)
    for expected, result in zip(serial, parallel, strict=True):
        assert (expected.words, expected.numbers.tobytes()) == (
            result.words,
            result.numbers.tobytes(),
        )
        assert not result.numbers.flags.writeable
    assert [expected.is_here for expected in parallel] == [False, True, False, False]


@pytest.mark.parametrize("workers", [0, 1])
def test_the_first_refusal_in_order_is_raised_with_its_numbers(workers):
    jobs = [
        Job(numbers=random_numbers(3)),
        Job(numbers=random_numbers(8), refused="missed by 3 dB"),
        Job(numbers=random_numbers(99), refused="missed by more"),
    ]
    with pytest.raises(TemplateError, match="missed by 3 dB") as error:
        run(*jobs, workers=workers)
    assert error.value.numbers == {"excess_dB": 3.0}
    assert error.value.exit_status == 4


def test_a_killed_worker_loses_no_result():
    jobs = [Job(numbers=random_numbers(count), dies=count == 7) for count in (5, 99, 7, 8)]
    results = run(*jobs, workers=1)
    assert [result.words["sum"] for result in results] == [
        float(job.numbers.sum()) for job in jobs
    ]


def test_jobs_after_a_killed_worker_run_in_this_process():
    jobs = [Job(numbers=random_numbers(count)) for count in (3, 99, 4)]
    with worker_pool(1, load) as pool:
        assert pool is not None
        assert (
            pool.submit(add, Job(numbers=random_numbers(1), dies=True), 0).exception() is not None
        )
        results = map_jobs(add, jobs, print, pool=pool, cost=lambda job: float(len(job.numbers)))
    assert [result.is_here for result in results] == [True, True, True]


def test_a_worker_that_cannot_load_loses_no_result():
    with worker_pool(1, sys.exit) as pool:
        jobs = [Job(numbers=random_numbers(3)), Job(numbers=random_numbers(99))]
        results = map_jobs(add, jobs, print, pool=pool, cost=lambda job: float(len(job.numbers)))
    assert [result.is_here for result in results] == [True, True]


def test_workers_report_their_steps():
    messages: list[str] = []
    run(
        Job(numbers=random_numbers(8)),
        Job(numbers=random_numbers(99)),
        workers=1,
        report=messages.append,
    )
    assert any("adding 8 numbers" in text for text in messages)
    assert any("adding 99 numbers" in text for text in messages)


@pytest.mark.parametrize("after_s", [0.0, 0.6])
def test_ctrl_c_ends_this_process_and_its_workers_with_status_130(after_s, tmp_path):
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
    os.killpg(process.pid, signal.SIGINT)  # a terminal sends it to all processes
    _, message = process.communicate(timeout=60)
    assert process.returncode == 130
    assert message == b"interrupted: no file is left half written\n"
    for _ in range(100):
        if not processes_of_session(process.pid):
            break
        time.sleep(0.05)
    assert not processes_of_session(process.pid)


def processes_of_session(leader: int) -> list[str]:
    """Return the running processes of a session."""
    command = ["ps", "-o", "pid=,args=", "-s", str(leader)]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.split()


def _blocked_signals(*_: object) -> set[int]:
    return set(signal.pthread_sigmask(signal.SIG_BLOCK, ()))


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="no masks of signals here")
def test_ctrl_c_in_a_terminal_does_not_reach_the_workers_of_a_batch():
    with cluster_client("", 1) as client:
        assert signal.SIGINT not in _blocked_signals()
        (blocked,) = client.run(_blocked_signals).values()
    assert signal.SIGINT in blocked


def test_no_thread_of_a_pool_outlives_it():
    # A thread that closes its pipe while Python ends prints a traceback after a refusal.
    with pytest.raises(ZeroDivisionError), worker_pool(1, load):
        raise ZeroDivisionError
    kinds = {type(thread).__name__ for thread in threading.enumerate()}
    assert "_ExecutorManagerThread" not in kinds
