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
import zipfile
from collections import Counter
from collections.abc import Callable, Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from piezoid.design.design import design_from_json
from piezoid.design.specification import Specification, specifications_from_toml
from piezoid.diagnosis.diagnosis import read_diagnoses
from piezoid.errors import PiezoidError
from piezoid.export.parameter_file import from_json, to_json
from piezoid.identification.store import read_model, write_model
from piezoid.provenance import seal
from piezoid.records.inspection import inspect_file
from piezoid.records.lab import read_lab
from piezoid.verification.limits import limits_from_toml
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import stage_from_json
from tests.export.stage import stage
from tests.records.formats import SILENT, SPEAKING
from tests.reports.known_stage import axis_model, stage_model

LIMIT_s = 5.0
ROOM_bytes = 2 << 30
KEPT = Path("build/fuzz")
POOL = 300
REFUSED = "refused:"
CORPUS = Path(__file__).parents[1] / "tests" / "records" / "corpus.zip"
LAB_OF_RUN = b"""[acquisition]
sampling_rate_Hz = 2000
[[recording]]
file = "run.csv"
axis = "x"
sampling_rate_Hz = 2e3
start_s = 0.01
stop_s = 0.08
columns = { time = "time [s]", voltage = 2, displacement = "displacement" }
units = { voltage = "mV", displacement = "nm" }
"""
ASKED = {
    "x": Specification(
        bandwidth_Hz=90.0, delay_margin_s=5e-5, voltage_min_V=-10.0, voltage_max_V=10.0,
        sensor_noise_rms=1e-9, scan_frequency_Hz=10.0, disturbance_rms=1e-7,
    )
}  # fmt: skip
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
        return resealed(mutated_bytes(content, rng))
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


def resealed(content: bytes) -> bytes:
    """Write the digest that the damaged bytes need; the bytes as they are where there is none."""
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
        "verification.json": verification_from_json,
        "batch.json": stage_from_json,
    }


def targets(folder: Path, given: Path | None) -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Return a first input and the reader of every kind of file."""
    found: dict[str, tuple[bytes, Callable[[Path], str]]] = {}
    for name, write in {**SPEAKING, **SILENT}.items():
        write(folder / name)
        found[name] = ((folder / name).read_bytes(), answer_to_recording)
    found["lab.toml"] = (LAB.read_bytes(), lambda place: str(len(read_lab(place).recordings)))
    found["lab and run.csv"] = (
        LAB_OF_RUN,
        lambda place: _answer_with_lab(place, folder / "run.csv"),
    )
    wanted = b"[x]\nbandwidth_Hz = 120\n[[x.template]]\nname = 'a'\nfunction = 'Syp'\n"
    wanted += b"frequency_Hz = [500, 800]\nupper_dB = [3, 3]\n"
    found["design.toml"] = (
        wanted,
        lambda p: str(specifications_from_toml(p.read_text("utf-8"), ASKED)),
    )
    limits = b"aligned_percent = 0.5\njudged_Hz = 20\n"
    found["limits.toml"] = (limits, lambda p: str(limits_from_toml(p.read_text("utf-8"), p.name)))
    known = {"model.json": write_model(stage_model(axis_model())), "params.json": to_json(stage())}
    for name, reader in sealed_readers().items():
        held = known.get(name, b"")
        if given is not None and (given / name).exists():
            held = (given / name).read_bytes()
        held = held or corpus(name).get("first", b"")
        if held:
            found[name] = (held, _answer_to_sealed(reader))
    return found


def _answer_with_lab(place: Path, recording: Path) -> str:
    """Read a recording as a lab.toml says it is to be read."""
    given = recording.with_name("lab.toml")
    given.write_bytes(place.read_bytes())
    (found, *_) = inspect_file(recording, read_lab(given))
    if found.refusal:
        return f"{REFUSED} {found.refusal}"
    return " ".join(problem.kind for problem in found.problems)


def corpus(name: str) -> dict[str, bytes]:
    """Return the inputs that are kept for a target."""
    if not CORPUS.exists():
        return {}
    with zipfile.ZipFile(CORPUS) as archive:
        held = [m for m in archive.namelist() if m.startswith(f"{name}/")]
        return {member.partition("/")[2]: archive.read(member) for member in held}


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
    with tempfile.TemporaryDirectory(dir=memory_disk()) as folder:
        place = Path(folder) / name
        place.write_bytes(first)
        answer(place)  # loads what is loaded late, before time and memory are watched
        held_bytes = used_bytes()
        resource.setrlimit(resource.RLIMIT_AS, (held_bytes + ROOM_bytes,) * 2)
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
