"""Fuzz every reader with mutated files: each must return a result or one message of piezoid.

    python -m benchmarks.fuzz_readers [SECONDS [STAGE [SEED]]]

Mutates recordings of all formats, lab.toml and sealed files for SECONDS per target. STAGE, a
folder that `piezoid fit` wrote, adds its sealed files. The mutations depend on SEED alone. A
mutant with a new answer joins the pool of files that are mutated further. Each target runs in a
process that may allocate 2 GB, with 5 s of processor time per input. Inputs that break a rule or
do not end are written to build/fuzz/.
"""

import multiprocessing
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz_damage import mutated_bytes, mutated_json
from benchmarks.fuzz_targets import REFUSED, targets
from piezoid.errors import PiezoidError

LIMIT_s = 5.0
TIMEOUT_s = 60.0
MEMORY_bytes = 2 << 30
FAILURES = Path("build/fuzz")
POOL = 300


@dataclass
class Tally:
    """Answers of one target."""

    inputs: int = 0
    refused: int = 0
    answers: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0
    broken: Counter[str] = field(default_factory=Counter)

    def print_row(self, name: str) -> None:
        """Print the row of a target, and a line for each broken rule."""
        print(
            f"{name:16}{self.inputs:9}{self.refused:9}{self.answers:9}"
            f"{self.slowest_s:8.2f} s{self.peak_bytes / 2**20:6.0f} MB",
            flush=True,
        )
        for failure, count in sorted(self.broken.items(), key=lambda item: -item[1]):
            print(f"    {count} times {failure}", flush=True)


def fuzz(
    path: Path, first: bytes, read: Callable[[Path], str], seconds: float, seed: int
) -> Tally:
    """Mutate one file for the given time; a warning counts as a failure."""
    warnings.simplefilter("error")
    rng = np.random.default_rng([seed, *path.name.encode()])
    mutated = mutated_json if path.name.endswith(".json") else mutated_bytes
    tally, pool, answers = Tally(), [first], set()
    path.write_bytes(first)
    read(path)  # imports the lazy modules before time and memory are limited
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes() + MEMORY_bytes,) * 2)
    end_s = time.monotonic() + seconds
    while time.monotonic() < end_s:
        content = mutated(pool[int(rng.integers(len(pool)))], rng)
        path.write_bytes(content)
        answer = count_answer(read, path, content, tally)
        if answer not in answers and len(pool) < POOL:
            answers.add(answer)
            pool.append(content)
    tally.peak_bytes, tally.answers = peak_bytes(), len(answers)
    return tally


def count_answer(read: Callable[[Path], str], path: Path, content: bytes, tally: Tally) -> str:
    """Read one input and count the answer; return the answer without numbers and quotations.

    An input that breaks a rule is written to FAILURES.
    """
    start_s = time.process_time()
    tally.inputs += 1
    try:
        message = read(path)
        tally.refused += message.startswith(REFUSED)
    except (PiezoidError, OSError, UnicodeDecodeError) as error:
        is_refused = isinstance(error, PiezoidError) or path.name in ("limits.toml", "design.toml")
        tally.refused += is_refused
        message = str(error)
        if not is_refused:
            _store_failure(path.name, content, tally, _location(error))
    except BaseException as error:
        message = _location(error)
        _store_failure(path.name, content, tally, message)
    elapsed_s = time.process_time() - start_s
    tally.slowest_s = max(tally.slowest_s, elapsed_s)
    if elapsed_s > LIMIT_s:
        _store_failure(path.name, content, tally, f"took more than {LIMIT_s:.0f} s")
    return re.sub(r"[^a-zA-Z ]+|'.*'", "", message)[:100]


def _location(error: BaseException) -> str:
    frame = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(frame.filename).name}:{frame.lineno}: {error}"[:160]


def _store_failure(name: str, content: bytes, tally: Tally, failure: str) -> None:
    if not tally.broken[failure]:
        FAILURES.mkdir(parents=True, exist_ok=True)
        (FAILURES / f"{len(tally.broken)}-{name}").write_bytes(content)
    tally.broken[failure] += 1


def memory_disk() -> str | None:
    """Return a folder in memory, or None if the system has none."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def peak_bytes() -> int:
    """Return the peak memory of this process."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def used_bytes() -> int:
    """Return the address space of this process."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _fuzz_and_send(pipe: Any, *arguments: Any) -> None:
    pipe.send(fuzz(*arguments))


def fuzz_in_process(
    name: str, first: bytes, read: Callable[[Path], str], seconds: float, seed: int
) -> Tally:
    """Fuzz one target in a child process, which is killed if it does not end."""
    fork = multiprocessing.get_context("fork")
    receiver, sender = fork.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(dir=memory_disk()) as folder:
        path = Path(folder) / name
        child = fork.Process(
            target=_fuzz_and_send, args=(sender, path, first, read, seconds, seed)
        )
        child.start()
        sender.close()
        tally, failure = Tally(), f"an input did not end, {TIMEOUT_s:.0f} s overdue"
        try:
            if receiver.poll(seconds + TIMEOUT_s):
                failure = "the process died"
                return receiver.recv()
        except EOFError:
            pass
        finally:
            child.kill()
            child.join()
        _store_failure(name, path.read_bytes(), tally, failure)
    return tally


def main() -> None:
    """Print a row for each target; exit with status 1 if a rule was broken."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    stage_folder = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 7
    inputs, is_broken, start_s = 0, False, time.monotonic()
    print(f"{'':16}{'inputs':>9}{'refused':>9}{'answers':>9}{'slowest':>10}{'peak':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for name, (first, read) in targets(Path(folder), stage_folder).items():
            tally = fuzz_in_process(name, first, read, seconds, seed)
            inputs += tally.inputs
            is_broken |= bool(tally.broken)
            tally.print_row(name)
    print(f"{inputs} inputs in {time.monotonic() - start_s:.0f} s")
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
