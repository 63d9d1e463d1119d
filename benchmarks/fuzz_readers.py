"""Throw damaged files at everything that reads: a result or one message of ours, nothing else.

    python -m benchmarks.fuzz_readers [SECONDS [STAGE]]

Every format of recordings, lab.toml, and the sealed files are mutated, SECONDS for each; STAGE, a
folder that `piezoid fit` wrote, adds its sealed files to those known here. A mutant of a sealed
file is sealed again: only then is its content read at all. Mutants that are answered in a new way
join those that are mutated further. Each target runs in a process with 2 GB more than it starts
with, and 5 s of processor time for an input; what breaks a rule is kept in build/fuzz/.
"""

import hashlib
import json
import multiprocessing
import re
import resource
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from piezoid.design.design import design_from_json
from piezoid.diagnosis.diagnosis import read_diagnoses
from piezoid.errors import PiezoidError
from piezoid.export.parameter_file import from_json, to_json
from piezoid.identification.store import read_model, write_model
from piezoid.provenance import seal
from piezoid.records.inspection import inspect_file
from piezoid.records.lab import read_lab
from piezoid.verification.limits import limits_from_toml
from tests.export.stage import stage
from tests.records.formats import SILENT, SPEAKING
from tests.reports.known_stage import axis_model, stage_model

LIMIT_s = 5.0
ROOM_bytes = 2 << 30
KEPT = Path("build/fuzz")
POOL = 300
REFUSED = "refused:"
LAB = Path(__file__).parents[1] / "datasets" / "lab.toml"
TOKENS = (
    *(b"1e308 -1e308 1e-320 nan inf -inf 1e999 0 -0 99999999999999999999 1,5 0x10".split()),
    *(b"\n \r \t , ; : = \" ' # [ ] { } [[ ]] [[recording]]".split(b" ")),
    *(b"\\ % \x00 \xff\xfe \xef\xbb\xbf".split(b" ")),
    *(b"\x00\x00\x00\x00 \xff\xff\xff\xff \x7f\xff\xff\xff \xff\xff\xff\x7f".split(b" ")),
    b"<script>alert(1)</script>",
    b"*/ int main(void) {",
    "µ m°²".encode(),
)  # fmt: skip
HARD: tuple[Any, ...] = (
    None, True, 0, -1, 1, 2**63, 10**400, 1e308, -1e308, 5e-324, "", "x", "NaN", [], [[]], [0], {},
    [1e308] * 3, {"x": {}}, "\x00", "</script><b>", 10**5, 0.5,
)  # fmt: skip


@dataclass
class Tally:
    """What one target answered."""

    inputs: int = 0
    refused: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0
    ways: int = 0
    broken: Counter[str] = field(default_factory=Counter)


def mutated_bytes(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage bytes: flips, cuts, repeats, swaps, hard tokens, numbers made hard."""
    damaged = bytearray(content)
    for _ in range(1 + int(rng.integers(4))):
        size = max(len(damaged), 1)
        # Headers stand at the beginning, and much depends on them.
        near = int(rng.integers(min(size, 600))) if rng.random() < 0.5 else int(rng.integers(size))
        far = near + int(rng.integers(1, 80))
        match int(rng.integers(7)):
            case 0:
                damaged[near:far] = bytes(rng.integers(256, size=far - near, dtype=np.uint8))
            case 1 if rng.random() < 0.3:
                del damaged[near:]
            case 2:
                del damaged[near:far]
            case 3:
                damaged[near:near] = damaged[near:far] * int(rng.integers(1, 9))
            case 4:
                token = TOKENS[int(rng.integers(len(TOKENS)))]
                damaged[near : near + len(token) * int(rng.integers(2))] = token
            case 5:
                numbers = list(re.finditer(rb"\d+", bytes(damaged[near : near + 4000])))
                if numbers:
                    begin, end = numbers[int(rng.integers(len(numbers)))].span()
                    damaged[near + begin : near + end] = TOKENS[int(rng.integers(12))]
            case _ if near < len(damaged):
                damaged[near] = int(rng.choice([0, 1, 2, 4, 8, 16, 32, 64, 127, 128, 255]))
    return bytes(damaged[: 1 << 20])


def mutated_json(content: bytes, rng: np.random.Generator) -> bytes:
    """Damage a sealed file's values, names and depth, or its text; then seal it."""
    try:
        record = None if rng.random() < 0.1 else json.loads(content)
    except (ValueError, RecursionError):
        record = None
    if not isinstance(record, dict) or not record.keys() - {"digest"}:
        return _resealed(mutated_bytes(content, rng))
    for _ in range(1 + int(rng.integers(2))):
        holder, key = _place_in(record, rng)
        match int(rng.integers(4)):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, list):
                holder.append(holder[key])
            case 2 if isinstance(holder, dict):
                holder[f"{key}_"] = holder.pop(key)
            case _:
                holder[key] = deepcopy(HARD[int(rng.integers(len(HARD)))])
    schema = record.pop("schema", "")
    record.pop("digest", None)
    return seal(schema, record) if isinstance(schema, str) and record else content


def _place_in(record: Any, rng: np.random.Generator) -> tuple[Any, Any]:
    holder, key = record, str(rng.choice([k for k in record if k not in ("digest",)]))
    while isinstance(holder[key], (dict, list)) and holder[key] and rng.random() < 0.9:
        holder = holder[key]
        names = list(holder) if isinstance(holder, dict) else range(len(holder))
        key = names[int(rng.integers(len(names)))]
    return holder, key


def _resealed(content: bytes) -> bytes:
    match = re.search(rb'"digest": "sha256:([0-9a-f]{64})"', content)
    if match is None:
        return content
    blank = content[: match.start(1)] + b"0" * 64 + content[match.end(1) :]
    digest = hashlib.sha256(blank).hexdigest().encode()
    return blank[: match.start(1)] + digest + blank[match.start(1) + 64 :]


def answer_to_recording(place: Path) -> str:
    """Read a recording the whole way; an inspection holds its refusal."""
    (found, *_) = inspect_file(place)
    if found.refusal:
        return f"{REFUSED} {found.refusal}"
    return " ".join((found.format or "", *(problem.kind for problem in found.problems)))


def sealed_readers() -> dict[str, Callable[[bytes, str], object]]:
    """Return what reads each sealed file."""
    return {
        "model.json": read_model,
        "diagnosis.json": read_diagnoses,
        "design.json": design_from_json,
        "params.json": from_json,
    }


def targets(folder: Path, given: Path | None) -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Return a first input and the reader of every kind of file."""
    found: dict[str, tuple[bytes, Callable[[Path], str]]] = {}
    for name, write in {**SPEAKING, **SILENT}.items():
        write(folder / name)
        found[name] = ((folder / name).read_bytes(), answer_to_recording)
    found["lab.toml"] = (LAB.read_bytes(), lambda place: str(len(read_lab(place).recordings)))
    limits = b"aligned_percent = 0.5\njudged_Hz = 20\n"
    found["limits.toml"] = (limits, lambda p: str(limits_from_toml(p.read_text("utf-8"), p.name)))
    known = {"model.json": write_model(stage_model(axis_model())), "params.json": to_json(stage())}
    for name, reader in sealed_readers().items():
        held = known.get(name, b"")
        if given is not None and (given / name).exists():
            held = (given / name).read_bytes()
        if held:
            found[name] = (held, _answer_to_sealed(reader))
    return found


def _answer_to_sealed(reader: Callable[[bytes, str], object]) -> Callable[[Path], str]:
    def answer(place: Path) -> str:
        reader(place.read_bytes(), place.name)
        return "read"

    return answer


def attack(name: str, first: bytes, answer: Callable[[Path], str], seconds: float) -> Tally:
    """Mutate one file for some seconds; a warning that would reach the user is a fault as well."""
    warnings.simplefilter("error")
    rng = np.random.default_rng([7, *name.encode()])
    mutated = mutated_json if name.endswith(".json") else mutated_bytes
    tally, pool, known = Tally(), [first], set()
    with tempfile.TemporaryDirectory(dir=_memory_disk()) as folder:
        place = Path(folder) / name
        place.write_bytes(first)
        answer(place)  # loads what is loaded late, before time and memory are watched
        held_bytes = _used_bytes()
        resource.setrlimit(resource.RLIMIT_AS, (held_bytes + ROOM_bytes,) * 2)
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            content = mutated(pool[int(rng.integers(len(pool)))], rng)
            place.write_bytes(content)
            way = _tried(answer, place, content, tally)
            if way not in known and len(pool) < POOL:
                known.add(way)
                pool.append(content)
    tally.peak_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    tally.ways = len(known)
    return tally


def _tried(answer: Callable[[Path], str], place: Path, content: bytes, tally: Tally) -> str:
    began_s = time.process_time()
    tally.inputs += 1
    try:
        said = answer(place)
        tally.refused += said.startswith(REFUSED)
    except (PiezoidError, OSError, UnicodeDecodeError) as error:
        is_ours = isinstance(error, PiezoidError) or place.name == "limits.toml"
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


def _memory_disk() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None


def _used_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _send(pipe: Any, name: str, task: Mapping[str, Any], seconds: float) -> None:
    first, answer = task[name]
    pipe.send(attack(name, first, answer, seconds))


def main() -> None:
    """Print a row for each target; end with status 1 where a rule was broken."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    given = Path(sys.argv[2]) if len(sys.argv) > 2 else None
    fork = multiprocessing.get_context("fork")
    inputs, is_broken, began = 0, False, time.monotonic()
    print(f"{'':16}{'inputs':>9}{'refused':>9}{'answers':>9}{'slowest':>10}{'peak':>9}")
    with tempfile.TemporaryDirectory() as folder:
        tasks = targets(Path(folder), given)
        for name in tasks:
            here, there = fork.Pipe(duplex=False)
            child = fork.Process(target=_send, args=(there, name, tasks, seconds))
            child.start()
            there.close()
            try:
                tally = here.recv()
            except EOFError:
                tally = Tally(broken=Counter({"the process died": 1}))
            child.join()
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
