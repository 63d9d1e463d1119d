"""Every verb that writes, on a full disk, on one that is read only, and twice at once.

    python -m benchmarks.hard_places STAGE [VERB ...]

STAGE is a folder that `piezoid fit` wrote. Each verb writes onto a disk of its own in memory, full
or mounted read only: that needs the right to mount. Whatever stood there must stand there still,
nothing beside it, and one message must say so with exit status 3. Two runs at once into one folder
must leave it whole, with the bytes of one of them.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from benchmarks.kill_fit import held, recording
from piezoid.output_folder import write_folder

PIEZOID = (sys.executable, "-m", "piezoid_cli.main")
OLD = {"kept.txt": b"what was there"}
UNUSABLE = 3
# Two runs at once: the later one finds the folder taken, where it may not replace.
TAKEN = {(0, 0), (0, 2), (2, 0)}


def commands(work: Path, out: Path) -> dict[str, list[str]]:
    """Return every verb with its words; ``out`` is the folder under test."""
    sweep, made = str(work / "s.csv"), str(out / "made")
    stage = str(out / "stage")
    return {
        "fit": ["fit", sweep, "--out", made, "--force", "--quiet"],
        "fit --stream": ["fit", sweep, "--stream", "--out", made, "--force", "--quiet"],
        "diagnose": ["diagnose", sweep, "--out", made, "--force", "--quiet"],
        "simulate": ["simulate", "--out", made, "--force", "--quiet"],
        "init": ["init", sweep, "--out", str(out / "made" / "lab.toml"), "--force", "--quiet"],
        "batch": ["batch", str(work / "night"), "--out", made, "--force", "--quiet"],
        "plan": ["plan", stage, "--effect", "creep", "--out", made, "--force", "--quiet"],
        "plan in place": ["plan", stage, "--effect", "creep", "--quiet"],
        "design": ["design", stage, "--quiet"],
        "export": ["export", stage, "--quiet"],
        "verify": ["verify", stage, "--quiet"],
        "report": ["report", stage, "--quiet"],
    }


def prepared(work: Path, out: Path, stage: Path) -> None:
    """Lay out what is read, and what stands where results will go."""
    shutil.copytree(stage, out / "stage")
    write_folder(out / "made", OLD)
    (work / "night" / "unit-1").mkdir(parents=True, exist_ok=True)
    recording(work / "s.csv")
    shutil.copy(work / "s.csv", work / "night" / "unit-1")
    (work / "night" / "unit-1" / "lab.toml").write_text('[rig]\nname = "unit 1"\n')


@contextmanager
def disk(place: Path, size: int) -> Iterator[None]:
    """Mount a disk of so many bytes in memory."""
    place.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", place], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", place], check=True)


def filled(place: Path) -> None:
    """Leave not a byte."""
    free = os.statvfs(place)
    (place / "filler").write_bytes(bytes(free.f_bavail * free.f_frsize))


def read_only(place: Path) -> None:
    """Forbid every change, to the first user as well."""
    subprocess.run(["mount", "-o", "remount,ro", place], check=True)


def run(words: list[str]) -> tuple[int, str]:
    """Run a verb to its end; status and what it said of its failure."""
    done = subprocess.run([*PIEZOID, *words], capture_output=True, text=True, check=False)
    return done.returncode, done.stderr


def faults(status: int, said: str, before: dict[str, bytes], after: dict[str, bytes]) -> list[str]:
    """Say what is wrong with the end of a verb that could not write."""
    found = []
    if status != UNUSABLE:
        found.append(f"status {status}")
    if "Traceback" in said or said.count("error:") != 1:
        found.append(f"said {said!r}")
    if after != before:
        found.append(f"changed {sorted(before.keys() ^ after.keys()) or 'contents'}")
    return found


def tried(verb: str, what: str, stage: Path) -> list[str]:
    """Let one verb meet one fault."""
    with tempfile.TemporaryDirectory() as name:
        work, out = Path(name), Path(name) / "disk"
        with disk(out, 64 << 20):
            prepared(work, out, stage)
            (filled if what == "full" else read_only)(out)
            before = held(out)
            status, said = run(commands(work, out)[verb])
            return faults(status, said, before, held(out))


def twice(verb: str, stage: Path) -> list[str]:
    """Let two runs of one verb begin together, then a third alone, for the bytes."""
    with tempfile.TemporaryDirectory() as name:
        work, out = Path(name), Path(name) / "out"
        out.mkdir()
        prepared(work, out, stage)
        words = [*PIEZOID, *commands(work, out)[verb]]
        both = [subprocess.Popen(words, stderr=subprocess.PIPE, text=True) for _ in range(2)]
        said = "".join(one.communicate()[1] for one in both)
        left = held(out)
        status, _ = run(words[len(PIEZOID) :])
        found = [] if (both[0].returncode, both[1].returncode) in TAKEN else [said]
        if status == 0 and held(out) != left:
            found.append("other bytes than of a run alone")
        remains = [path.name for path in out.rglob("*.unfinished")]
        return found + [f"remains {remains}"] * bool(remains)


def main() -> None:
    """Print a row for each verb; end with status 1 where a rule was broken."""
    stage, is_broken = Path(sys.argv[1]), False
    with suppress(BrokenPipeError):
        for verb in sys.argv[2:] or commands(Path(), Path()):
            rows = {what: tried(verb, what, stage) for what in ("full", "read only")}
            rows["twice"] = twice(verb, stage)
            for what, found in rows.items():
                print(f"{verb:15}{what:11}{'; '.join(found) or 'kept'}", flush=True)
                is_broken |= bool(found)
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
