"""Run every verb that writes: on a full disk, on a read-only disk, and twice at the same time.

    python -m benchmarks.hard_places STAGE [VERB ...]

STAGE is a folder that `piezoid fit` wrote. Each verb writes to a separate memory disk that is full
or mounted read-only, which needs the right to mount. The verb must end with exit status 3 and one
message, and the disk must keep its contents. Two simultaneous runs into one folder must leave the
complete output of one of them.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from benchmarks.kill_fit import folder_contents, write_recording
from piezoid.output_folder import write_folder

PIEZOID = (sys.executable, "-m", "piezoid_cli.main")
OLD = {"kept.txt": b"what was there"}
UNUSABLE = 3
# Exit statuses of two simultaneous runs: without --force the second one refuses the folder.
SIMULTANEOUS_STATUSES = {(0, 0), (0, 2), (2, 0)}


def commands(work: Path, out: Path) -> dict[str, list[str]]:
    """Return the arguments of every verb; ``out`` is the folder under test."""
    sweep, results = str(work / "s.csv"), str(out / "made")
    stage = str(out / "stage")
    return {
        "fit": ["fit", sweep, "--out", results, "--force", "--quiet"],
        "fit --stream": ["fit", sweep, "--stream", "--out", results, "--force", "--quiet"],
        "diagnose": ["diagnose", sweep, "--out", results, "--force", "--quiet"],
        "simulate": ["simulate", "--out", results, "--force", "--quiet"],
        "init": ["init", sweep, "--out", str(out / "made" / "lab.toml"), "--force", "--quiet"],
        "batch": ["batch", str(work / "night"), "--out", results, "--force", "--quiet"],
        "plan": ["plan", stage, "--effect", "creep", "--out", results, "--force", "--quiet"],
        "plan in place": ["plan", stage, "--effect", "creep", "--quiet"],
        "design": ["design", stage, "--quiet"],
        "export": ["export", stage, "--quiet"],
        "verify": ["verify", stage, "--quiet"],
        "report": ["report", stage, "--quiet"],
    }


def prepare(work: Path, out: Path, stage: Path) -> None:
    """Write the inputs, and older files into the output folder."""
    shutil.copytree(stage, out / "stage")
    write_folder(out / "made", OLD)
    (work / "night" / "unit-1").mkdir(parents=True, exist_ok=True)
    write_recording(work / "s.csv")
    shutil.copy(work / "s.csv", work / "night" / "unit-1")
    (work / "night" / "unit-1" / "lab.toml").write_text('[rig]\nname = "unit 1"\n')


@contextmanager
def disk(path: Path, size: int) -> Iterator[None]:
    """Mount a memory disk of the given size in bytes."""
    path.mkdir(exist_ok=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", path], check=True)
    try:
        yield
    finally:
        subprocess.run(["umount", path], check=True)


def fill(path: Path) -> None:
    """Write one file that uses all free bytes of the disk."""
    free = os.statvfs(path)
    (path / "filler").write_bytes(bytes(free.f_bavail * free.f_frsize))


def make_read_only(path: Path) -> None:
    """Remount the disk read-only, which binds root too."""
    subprocess.run(["mount", "-o", "remount,ro", path], check=True)


def run(arguments: list[str]) -> tuple[int, str]:
    """Run a verb; return its exit status and its standard error."""
    process = subprocess.run([*PIEZOID, *arguments], capture_output=True, text=True, check=False)
    return process.returncode, process.stderr


def faults_on_disk(verb: str, state: str, stage: Path) -> list[str]:
    """Run one verb on a disk that is full or read-only; return the broken rules."""
    with tempfile.TemporaryDirectory() as name:
        work, out = Path(name), Path(name) / "disk"
        with disk(out, 64 << 20):
            prepare(work, out, stage)
            (fill if state == "full" else make_read_only)(out)
            old = folder_contents(out)
            status, message = run(commands(work, out)[verb])
            new = folder_contents(out)
    faults = []
    if status != UNUSABLE:
        faults.append(f"status {status}")
    if "Traceback" in message or message.count("error:") != 1:
        faults.append(f"message {message!r}")
    if new != old:
        faults.append(f"changed {sorted(old.keys() ^ new.keys()) or 'contents'}")
    return faults


def faults_of_two_runs(verb: str, stage: Path) -> list[str]:
    """Start two runs of one verb together, then a third alone; return the broken rules."""
    with tempfile.TemporaryDirectory() as name:
        work, out = Path(name), Path(name) / "out"
        out.mkdir()
        prepare(work, out, stage)
        command = [*PIEZOID, *commands(work, out)[verb]]
        processes = [
            subprocess.Popen(command, stderr=subprocess.PIPE, text=True) for _ in range(2)
        ]
        message = "".join(process.communicate()[1] for process in processes)
        contents = folder_contents(out)
        status, _ = run(command[len(PIEZOID) :])
        statuses = tuple(process.returncode for process in processes)
        faults = [] if statuses in SIMULTANEOUS_STATUSES else [message]
        if status == 0 and folder_contents(out) != contents:
            faults.append("bytes differ from those of a single run")
        temporary = [path.name for path in out.rglob("*.unfinished")]
        return faults + [f"temporary files {temporary}"] * bool(temporary)


def main() -> None:
    """Print three rows for each verb; exit with status 1 if a rule was broken."""
    stage, is_broken = Path(sys.argv[1]), False
    with suppress(BrokenPipeError):
        for verb in sys.argv[2:] or commands(Path(), Path()):
            rows = {state: faults_on_disk(verb, state, stage) for state in ("full", "read only")}
            rows["twice"] = faults_of_two_runs(verb, stage)
            for state, faults in rows.items():
                print(f"{verb:15}{state:11}{'; '.join(faults) or 'kept'}", flush=True)
                is_broken |= bool(faults)
    sys.exit(int(is_broken))


if __name__ == "__main__":
    main()
