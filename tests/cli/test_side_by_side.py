"""Jobs in several processes: what comes back is what one process would have given."""

import os
import pickle
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import Event
from types import MappingProxyType

import numpy as np
import pytest

from piezoid.errors import ExcitationError, PiezoidError, TemplateError
from piezoid.numerics.arrays import Array
from piezoid_cli.other_process import others
from piezoid_cli.side_by_side import side_by_side

Told = Callable[[str], None]
HERE = os.getpid()


@dataclass(frozen=True, kw_only=True)
class Sum:
    """A job, and its own result; with a place, it waits here until one was done elsewhere."""

    numbers: Array
    words: MappingProxyType[str, float] = field(default_factory=lambda: MappingProxyType({}))
    parent: int = HERE
    refused: str = ""
    dies: bool = False
    place: str = ""


def work(job: Sum, told: Told) -> Sum:
    told(f"adding {len(job.numbers)} numbers")
    is_here = os.getpid() == job.parent
    if job.place and not is_here:
        Path(job.place).touch()
    while job.place and is_here and not Path(job.place).exists():
        time.sleep(0.01)
    if job.refused:
        raise TemplateError(job.refused, needed="9 \x1b dB", remedy="Ask for less.", excess_dB=3.0)
    if job.dies and not is_here:
        os.kill(os.getpid(), signal.SIGKILL)
    words = MappingProxyType({"sum": float(job.numbers.sum()), "here": float(is_here)})
    return Sum(numbers=np.asfortranarray(job.numbers), words=words)


def frozen(*shape: int) -> Array:
    numbers = np.random.default_rng(0).standard_normal(shape)
    numbers.setflags(write=False)
    return numbers


def run(*jobs: Sum, processes: int, told: Told = lambda _: None) -> list[Sum]:
    return side_by_side(
        work, jobs, told, processes=processes, weight=lambda job: float(job.numbers.size)
    )


def test_results_are_those_of_one_process_in_the_order_of_the_jobs(tmp_path: Path) -> None:
    jobs = [Sum(numbers=frozen(count, 3)) for count in (5, 40, 0, 7)]
    alone = run(*jobs, processes=1)
    shared = [replace(job, place=str(tmp_path / "begun")) for job in jobs]
    together = run(*shared, processes=2)
    for job, one, other in zip(jobs, alone, together, strict=True):
        assert one.words["sum"] == other.words["sum"] == job.numbers.sum()
        assert one.numbers.tobytes("A") == other.numbers.tobytes("A")
        assert other.numbers.shape == job.numbers.shape
        assert other.numbers.flags.f_contiguous
        assert other.words["here"] or not other.numbers.flags.writeable
    assert [one.words["here"] for one in alone] == [1.0, 1.0, 1.0, 1.0]
    assert 0.0 in [one.words["here"] for one in together]


def test_the_heaviest_job_begins_here_while_the_others_are_still_starting(tmp_path: Path) -> None:
    place = str(tmp_path / "begun")
    jobs = [Sum(numbers=frozen(count), place=place) for count in (4, 9, 5)]
    assert [one.words["here"] for one in run(*jobs, processes=2)][1] == 1.0


def load() -> None:
    """Take a while, and leave word of it."""
    time.sleep(0.2)
    os.environ["LOADED"] = "yes"


def loaded(job: Sum, told: Told) -> str:
    """Say whether whoever does this job had loaded before."""
    work(job, told)
    return "here" if os.getpid() == job.parent else os.environ.get("LOADED", "no")


def test_a_process_that_was_begun_before_the_jobs_were_known_does_them_once_it_has_loaded(
    tmp_path: Path,
) -> None:
    jobs = [Sum(numbers=frozen(count), place=str(tmp_path / "begun")) for count in (4, 9, 5)]
    with others(1, load) as begun:
        found = side_by_side(loaded, jobs, print, processes=2, weight=len_of, begun=begun)
    assert set(found) == {"here", "yes"}
    assert found[1] == "here"


def fail() -> None:
    """Not get ready."""
    raise ImportError("no such library")


def test_a_process_that_never_gets_ready_takes_no_job() -> None:
    jobs = [Sum(numbers=frozen(count)) for count in (4, 9)]
    with others(1, fail) as begun:
        found = side_by_side(work, jobs, print, processes=2, weight=len_of, begun=begun)
    assert [one.words for one in found] == [
        {"sum": float(job.numbers.sum()), "here": 1.0} for job in jobs
    ]


def len_of(job: Sum) -> float:
    return float(len(job.numbers))


def test_two_processes_say_what_both_do_in_the_order_of_the_jobs() -> None:
    said: list[str] = []
    both = Event()

    def told(text: str) -> None:  # whoever says something first waits for the other
        said.append(text)
        if len(said) == 2:
            both.set()
        assert both.wait(20)

    run(Sum(numbers=frozen(8)), Sum(numbers=frozen(9)), processes=2, told=told)
    assert said[0] in ("adding 8 numbers", "adding 9 numbers")
    assert said[1] == "adding 8 numbers | adding 9 numbers"


@pytest.mark.parametrize("processes", [1, 2])
def test_a_refusal_is_the_first_in_order_with_its_message_its_status_and_its_numbers(
    processes: int, tmp_path: Path
) -> None:
    place = str(tmp_path / "begun") if processes > 1 else ""
    jobs = [
        Sum(numbers=frozen(3)),
        Sum(numbers=frozen(8), place=place, refused="missed by 3 dB"),
        Sum(numbers=frozen(9), place=place, refused="missed by more"),
    ]
    with pytest.raises(TemplateError) as raised:
        run(*jobs, processes=processes)
    assert str(raised.value) == "missed by 3 dB. Needed: 9 \\x1b dB. Ask for less."
    assert raised.value.exit_status == 4
    assert raised.value.numbers == {"excess_dB": 3.0}
    assert (raised.value.needed, raised.value.remedy) == ("9 \\x1b dB", "Ask for less.")


def test_what_a_killed_process_was_doing_is_done_here(tmp_path: Path) -> None:
    place = str(tmp_path / "begun")
    jobs = [Sum(numbers=frozen(count), dies=True, place=place) for count in (4, 5, 6)]
    found = run(*jobs, processes=3)
    assert [one.words["sum"] for one in found] == [job.numbers.sum() for job in jobs]
    assert {one.words["here"] for one in found} == {1.0}


def test_a_job_that_cannot_be_sent_is_done_here() -> None:
    words: MappingProxyType[str, float] = MappingProxyType({"not a record": (lambda: 0.0)})  # type: ignore[dict-item]
    jobs = [Sum(numbers=frozen(count), words=words) for count in (4, 5)]
    assert [one.words["here"] for one in run(*jobs, processes=2)] == [1.0, 1.0]


def test_an_error_said_elsewhere_is_said_here_word_for_word() -> None:
    found: PiezoidError = pickle.loads(
        pickle.dumps(ExcitationError("x" * 3000 + "\x07", needed="9 V", remedy="Drive more."))
    )
    assert isinstance(found, ExcitationError)
    assert str(found) == f"{'x' * 2000} .... Needed: 9 V. Drive more."


INTERRUPTED = """
import os, signal, sys, time
from piezoid_cli.other_process import others
from piezoid_cli.side_by_side import side_by_side

def work(job, told):
    told(f"{os.getpid()}")
    time.sleep(600)

def told(text):
    for pid in text.split(" | "):
        print(pid, flush=True)

if __name__ == "__main__":
    # whoever is started in the background of a shell inherits that Ctrl-C is not for it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    side_by_side(work, [1, 2], told, processes=2, weight=float)
"""


def test_ctrl_c_ends_every_process_and_one_of_them_says_so(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(INTERRUPTED)
    process = subprocess.Popen(
        [sys.executable, script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
    )
    assert process.stdout is not None
    pids: set[int] = set()
    while len(pids) < 2:
        pids.add(int(process.stdout.readline()))
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=120)
    assert process.returncode != 0
    assert said.count("Traceback") == 1
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


HEARD = """
import os, signal, threading, time
from piezoid_cli.other_process import others

def press(waits):
    for wait_s, go in waits:
        go.wait()
        time.sleep(wait_s)
        os.kill(os.getpid(), signal.SIGINT)

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)
    waits = [(wait / 2000, threading.Event()) for wait in range(30)]
    threading.Thread(target=press, args=(waits,), daemon=True).start()
    for _, go in waits:
        try:
            go.set()
            with others(2):
                time.sleep(0.3)
        except KeyboardInterrupt:
            print("heard")
"""


def test_ctrl_c_is_heard_whenever_it_comes_while_processes_are_begun(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(HEARD)
    ran = subprocess.run(
        [sys.executable, script], capture_output=True, text=True, timeout=120, check=True
    )
    assert ran.stdout.count("heard") == 30
    assert not ran.stderr
