"""Throw damaged files at everything that reads: a result or one message of ours, nothing else.

    python -m benchmarks.fuzz_readers [SECONDS [STAGE [SEED]]]

Every format of recordings, lab.toml, and the sealed files are mutated, SECONDS for each; STAGE, a
folder that `piezoid fit` wrote, adds its sealed files to those known here. The same SEED draws
the same damage: another one asks new questions. A mutant of a sealed file is sealed again: only
then is its content read at all. Mutants that are answered in a new way join those that are
mutated further. Each target runs in a process with 2 GB more than it starts with, and 5 s of
processor time for an input; what breaks a rule, or never ends, is kept in build/fuzz/.
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
LOST_s = 60.0
ROOM_bytes = 2 << 30
KEPT = Path("build/fuzz")
POOL = 300


@dataclass
class Tally:
    """What one target answered."""

    inputs: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0
    ways: int = 0
    broken: Counter[str] = field(default_factory=Counter)


def attack(
    place: Path, first: bytes, answer: Callable[[Path], str], seconds: float, seed: int
) -> Tally:
    """Mutate one file for some seconds; a warning that would reach the user is a fault as well."""
    warnings.simplefilter("error")
    rng = np.random.default_rng([seed, *place.name.encode()])
    mutated = mutated_json if place.name.endswith(".json") else mutated_bytes
    tally, pool, known = Tally(), [first], set()
    place.write_bytes(first)
    answer(place)  # loads what is loaded late, before time and memory are watched
    resource.setrlimit(resource.RLIMIT_AS, (used_bytes() + ROOM_bytes,) * 2)
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        content = mutated(pool[int(rng.integers(len(pool)))], rng)
        place.write_bytes(content)
        way = tried(answer, place, content, tally)
        if way not in known and len(pool) < POOL:
            known.add(way)
            pool.append(content)
    tally.peak_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tally.ways = len(known)
    return tally


def tried(answer: Callable[[Path], str], place: Path, content: bytes, tally: Tally) -> str:
    """Read one input, count it, keep it where it breaks a rule; return the way of the answer."""
    began_s = time.process_time()
    tally.inputs += 1
    try:
        said = answer(place)
        tally.refused += said.startswith(REFUSED)
    except (PiezoidError, OSError, UnicodeDecodeError) as error:
        is_ours = isinstance(error, PiezoidError) or place.name in ("limits.toml", "design.toml")
        tally.refused += is_ours
        said = str(error)
        if not is_ours:
            _keep(place.name, content, tally, _where(error))
    except BaseException as error:
        said = _where(error)
        _keep(place.name, content, tally, said)
    took_s = time.process_time() - began_s
    tally.slowest_s = max(tally.slowest_s, took_s)
    if took_s > LIMIT_s:
        _keep(place.name, content, tally, f"took more than {LIMIT_s:.0f} s")
    return re.sub(r"[^a-zA-Z ]+|'.*'", "", said)[:100]


def _where(error: BaseException) -> str:
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{type(error).__name__} in {Path(last.filename).name}:{last.lineno}: {error}"[:160]


def _keep(name: str, content: bytes, tally: Tally, what: str) -> None:
    if not tally.broken[what]:
        KEPT.mkdir(parents=True, exist_ok=True)
        (KEPT / f"{len(tally.broken)}-{name}").write_bytes(content)
    tally.broken[what] += 1


def memory_disk() -> str | None:
    """Return a folder in memory, None where the system has none."""
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def used_bytes() -> int:
    """Return the address space this process has taken."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _send(pipe: Any, *asked: Any) -> None:
    pipe.send(attack(*asked))


def attacked(
    name: str, first: bytes, answer: Callable[[Path], str], seconds: float, seed: int
) -> Tally:
    """Attack one target in a process of its own, and end the process where it does not."""
    fork = multiprocessing.get_context("fork")
    here, there = fork.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(dir=memory_disk()) as folder:
        place = Path(folder) / name
        child = fork.Process(target=_send, args=(there, place, first, answer, seconds, seed))
        child.start()
        there.close()
        tally, what = Tally(), f"an input without end, {LOST_s:.0f} s too late"
        try:
            if here.poll(seconds + LOST_s):
                what = "the process died"
                return here.recv()
        except EOFError:
            pass
        finally:
            child.kill()
            child.join()
        _keep(name, place.read_bytes(), tally, what)
    return tally


def main() -> None:
    """Print a row for each target; end with status 1 where a rule was broken."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    given = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    seed = int(sys.argv[3]) if len(sys.argv) > 3 else 7
    inputs, is_broken, began = 0, False, time.monotonic()
    print(f"{'':16}{'inputs':>9}{'refused':>9}{'answers':>9}{'slowest':>10}{'peak':>9}")
    with tempfile.TemporaryDirectory() as folder:
        for name, (first, answer) in targets(Path(folder), given).items():
            tally = attacked(name, first, answer, seconds, seed)
            inputs += tally.inputs
            is_broken |= bool(tally.broken)
            print(
                f"{name:16}{tally.inputs:9}{tally.refused:9}{tally.ways:9}"
                f"{tally.slowest_s:8.2f} s{tally.peak_bytes / 2**20:6.0f} MB",
                flush=True,
            )
            for what, count in tally.broken.most_common():
                print(f"    {count} times {what}", flush=True)
    print(f"{inputs} inputs in {time.monotonic() - began:.0f} s")
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
