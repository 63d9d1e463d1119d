"""Coverage-guided fuzzing of every reader by libFuzzer, through atheris.

    python -m benchmarks.fuzz_coverage SECONDS [TARGET ...]

Needs the package atheris 3.0.0. Targets and rules are those of fuzz_targets and fuzz_readers. An
input joins the pool if it reaches a new line of piezoid, nptdms or pymatreader. Pools start with
tests/records/corpus.zip and persist in build/fuzz/pool/. Each target runs in a separate process.
"""

import json
import re
import resource
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path

import numpy as np

POOLS = Path("build/fuzz/pool")
TALLIES = Path("build/fuzz/tally")
FOLLOWED = ("piezoid", "nptdms", "pymatreader", "tomllib")
TEXTS = (".csv", ".tsv", ".txt", ".dat", ".lvm")
INTERVAL = 500  # inputs between two writes of the tally: the library ends the process


def mutator(name, atheris):
    """Return the mutator of one target: half of the mutations are libFuzzer's, half piezoid's."""
    from benchmarks import fuzz_damage

    def libfuzzer_bytes(content, _):
        return atheris.Mutate(content, len(content) + 256)

    def mutate(content, max_bytes, seed):
        rng = np.random.default_rng(seed)
        damage = libfuzzer_bytes if rng.random() < 0.5 else fuzz_damage.mutated_bytes
        if name.endswith(".json"):
            if damage is libfuzzer_bytes:
                return fuzz_damage.resealed(damage(content, rng))[:max_bytes]
            return fuzz_damage.mutated_json(content, rng)[:max_bytes]
        is_packed = name.endswith((".gz", ".npz")) and rng.random() < 0.8
        mutant = fuzz_damage.repacked(content, rng, damage) if is_packed else None
        return (damage(content, rng) if mutant is None else mutant)[:max_bytes]

    return mutate


def fuzz_target(name, options):
    """Fuzz one target until the library ends the process."""
    import atheris

    with atheris.instrument_imports(include=list(FOLLOWED)):
        import nptdms  # noqa: F401
        import pymatreader  # noqa: F401

        from benchmarks import fuzz_readers, fuzz_targets
    folder = Path(tempfile.mkdtemp(dir=fuzz_readers.memory_disk()))
    first, read = fuzz_targets.targets(folder, None)[name]
    if name.endswith(TEXTS):  # 60 lines exercise a reader as well as all of them
        first = b"".join(first.splitlines(keepends=True)[:60])
    path = folder / "under test" / name
    path.parent.mkdir()
    path.write_bytes(first)
    read(path)
    limit = fuzz_readers.used_bytes() + fuzz_readers.MEMORY_bytes
    resource.setrlimit(resource.RLIMIT_AS, (limit,) * 2)
    tally = fuzz_readers.Tally()
    TALLIES.mkdir(parents=True, exist_ok=True)

    def test(content):
        path.write_bytes(content)
        fuzz_readers.count_answer(read, path, content, tally)
        if tally.inputs % INTERVAL == 0:
            tally.peak_bytes = fuzz_readers.peak_bytes()
            (TALLIES / f"{name}.json").write_text(json.dumps(asdict(tally)))

    pool = POOLS / name
    pool.mkdir(parents=True, exist_ok=True)
    (pool / "first").write_bytes(first)
    for short, content in fuzz_targets.corpus(name).items():
        (pool / short).write_bytes(content)
    longest = max(1 << 14, 2 * len(first))
    fixed = ["-rss_limit_mb=0", "-malloc_limit_mb=0", "-timeout=300", "-verbosity=0"]
    arguments = [sys.argv[0], *fixed, f"-max_len={longest}", *options, str(pool)]
    atheris.Setup(arguments, test, custom_mutator=mutator(name, atheris))
    atheris.Fuzz()


def main():
    """Run every target, or the requested ones, for SECONDS each; print a row for each."""
    if sys.argv[1] == "--one":
        fuzz_target(sys.argv[2], sys.argv[3:])
        return
    from benchmarks import fuzz_readers, fuzz_targets

    with tempfile.TemporaryDirectory() as folder:
        names = list(fuzz_targets.targets(Path(folder), None))
    inputs, is_broken = 0, False
    print(f"{'':16}{'inputs':>9}{'refused':>9}{'lines':>9}{'slowest':>10}{'peak':>9}")
    for name in sys.argv[2:] or names:
        (TALLIES / f"{name}.json").unlink(missing_ok=True)
        command = [sys.executable, "-m", "benchmarks.fuzz_coverage", "--one", name]
        process = subprocess.run(
            [*command, f"-max_total_time={sys.argv[1]}", "-print_final_stats=1", "-verbosity=1"],
            capture_output=True, text=True, check=False, errors="replace",
        )  # fmt: skip
        covered = re.findall(r"cov: (\d+)", process.stderr) or ["0"]
        try:
            tally = fuzz_readers.Tally(**json.loads((TALLIES / f"{name}.json").read_text()))
        except FileNotFoundError:
            print(f"{name:16} ended early:\n{process.stderr[-2000:]}", flush=True)
            is_broken = True
            continue
        tally.answers = int(covered[-1])  # here the covered lines
        inputs += tally.inputs
        is_broken |= bool(tally.broken) or process.returncode != 0
        tally.print_row(name)
        if process.returncode:
            print(
                f"    the process ended with {process.returncode}: {process.stderr[-800:]}",
                flush=True,
            )
    print(f"{inputs} inputs")
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
