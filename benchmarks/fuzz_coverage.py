"""Let coverage choose the damage: libFuzzer, by way of atheris, on everything that reads.

    python -m benchmarks.fuzz_coverage SECONDS [TARGET ...]

Needs the package atheris 3.0.0 beside piezoid's own. Targets and rules are those of fuzz_targets
and fuzz_readers; what is new is that an input joins the pool where it reaches a new line of ours,
of nptdms or of pymatreader. Pools are kept in build/fuzz/pool/ from run to run, and begin with the
small ones of tests/records/corpus.zip; each target runs in a process of its own.
"""

import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

POOLS = Path("build/fuzz/pool")
TALLIES = Path("build/fuzz/tally")
FOLLOWED = ("piezoid", "nptdms", "pymatreader", "tomllib")
TEXTS = (".csv", ".tsv", ".txt", ".dat", ".lvm")
EVERY = 500  # inputs between two notes of the tally; the library ends without a farewell


def shortened(content):
    """Return a text's first lines: what forty rows cannot show, two hundred do not either."""
    return b"".join(content.splitlines(keepends=True)[:60])


def mutator_of(name, atheris):
    """Return what damages an input of one target: half the library's way, half ours."""
    from benchmarks import fuzz_damage

    def theirs(content, _):
        return atheris.Mutate(content, len(content) + 256)

    def mutated(content, most, seed):
        rng = np.random.default_rng(seed)
        damage = theirs if rng.random() < 0.5 else fuzz_damage.mutated_bytes
        if name.endswith(".json"):
            if damage is theirs:
                return fuzz_damage.resealed(theirs(content, rng))[:most]
            return fuzz_damage.mutated_json(content, rng)[:most]
        packed = name.endswith((".gz", ".npz")) and rng.random() < 0.8
        changed = fuzz_damage.repacked(content, rng, damage) if packed else None
        return (damage(content, rng) if changed is None else changed)[:most]

    return mutated


def one(name, options):
    """Fuzz one target until the library ends the process."""
    import atheris

    with atheris.instrument_imports(include=list(FOLLOWED)):
        import nptdms  # noqa: F401
        import pymatreader  # noqa: F401

        from benchmarks import fuzz_readers, fuzz_targets
    folder = Path(tempfile.mkdtemp(dir=fuzz_readers.memory_disk()))
    first, answer = fuzz_targets.targets(folder, None)[name]
    first = shortened(first) if name.endswith(TEXTS) else first
    place = folder / "under test" / name
    place.parent.mkdir()
    place.write_bytes(first)
    answer(place)
    limit = fuzz_readers.used_bytes() + fuzz_readers.ROOM_bytes
    resource.setrlimit(resource.RLIMIT_AS, (limit,) * 2)
    tally, began = fuzz_readers.Tally(), time.monotonic()

    def test(content):
        place.write_bytes(content)
        fuzz_readers.tried(answer, place, content, tally)
        if tally.inputs % EVERY == 0:
            _note(name, tally, time.monotonic() - began)

    pool = POOLS / name
    pool.mkdir(parents=True, exist_ok=True)
    (pool / "first").write_bytes(first)
    for short, content in fuzz_targets.corpus(name).items():
        (pool / short).write_bytes(content)
    longest = max(1 << 14, 2 * len(first))
    fixed = ["-rss_limit_mb=0", "-malloc_limit_mb=0", "-timeout=300", "-verbosity=0"]
    arguments = [sys.argv[0], *fixed, f"-max_len={longest}", *options, str(pool)]
    mutator = mutator_of(name, atheris)
    atheris.Setup(arguments, test, custom_mutator=mutator)
    atheris.Fuzz()


def _note(name, tally, took_s):
    TALLIES.mkdir(parents=True, exist_ok=True)
    peak_bytes = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    record = {
        "inputs": tally.inputs,
        "refused": tally.refused,
        "slowest_s": tally.slowest_s,
        "peak_bytes": peak_bytes,
        "broken": dict(tally.broken),
        "took_s": took_s,
    }
    (TALLIES / f"{name}.json").write_text(json.dumps(record))


def main():
    """Run every target, or those named, for SECONDS each; print a row for each."""
    if sys.argv[1] == "--one":
        one(sys.argv[2], sys.argv[3:])
        return
    from benchmarks import fuzz_targets

    with tempfile.TemporaryDirectory() as folder:
        known = list(fuzz_targets.targets(Path(folder), None))
    inputs, is_broken = 0, False
    print(f"{'':16}{'inputs':>9}{'refused':>9}{'lines':>9}{'slowest':>10}{'peak':>9}")
    for name in sys.argv[2:] or known:
        (TALLIES / f"{name}.json").unlink(missing_ok=True)
        command = [sys.executable, "-m", "benchmarks.fuzz_coverage", "--one", name]
        done = subprocess.run(
            [*command, f"-max_total_time={sys.argv[1]}", "-print_final_stats=1", "-verbosity=1"],
            capture_output=True, text=True, check=False, errors="replace",
        )  # fmt: skip
        covered = re.findall(r"cov: (\d+)", done.stderr) or ["0"]
        try:
            tally = json.loads((TALLIES / f"{name}.json").read_text())
        except FileNotFoundError:
            print(f"{name:16} ended early:\n{done.stderr[-2000:]}", flush=True)
            is_broken = True
            continue
        inputs += tally["inputs"]
        is_broken |= bool(tally["broken"]) or done.returncode != 0
        print(
            f"{name:16}{tally['inputs']:9}{tally['refused']:9}{covered[-1]:>9}"
            f"{tally['slowest_s']:8.2f} s{tally['peak_bytes'] / 2**20:6.0f} MB",
            flush=True,
        )
        for what, count in tally["broken"].items():
            print(f"    {count} times {what}", flush=True)
        if done.returncode:
            print(
                f"    the process ended with {done.returncode}: {done.stderr[-800:]}", flush=True
            )
    print(f"{inputs} inputs")
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
