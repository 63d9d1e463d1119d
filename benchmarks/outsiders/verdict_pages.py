"""Output of inspect and fit on hurried recordings, beside the verdict of a physicist.

    python -m benchmarks.outsiders.verdict_pages [--first 101] [--kinds a,b] --out FOLDER

Writes a page of text for each kind of recording: the verdict, what the output must and must not
convey, and the output of both verbs. A person compares them.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parent / "dogwood"))
import recordings  # its modules import each other from their folder


def page(kind: str, seed: int) -> str:
    """Write the recordings of one case and return the page."""
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        case = recordings.write(kind, seed, folder)
        files, lab = sorted(folder.glob("*.csv")), folder / "lab.toml"
        lab_option = ["--lab", lab] if lab.exists() else []
        lines = [
            f"{kind}, seed {seed}",
            case["verdict"],
            *(f"must: {statement}" for statement in case["must"]),
            *(f"must not: {statement}" for statement in case["must_not"]),
            _output("inspect", *files, *lab_option),
            _output("fit", *files, *lab_option, "--out", folder / "stage"),
        ]
    return "\n".join(lines)


def _output(verb: str, *arguments: object) -> str:
    program = Path(sys.executable).with_name("piezoid")
    command = [str(program), verb, *map(str, arguments)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    return f"--- {verb}, status {process.returncode}\n{process.stdout}{process.stderr}"


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--kinds", default=",".join(recordings.cases()))
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number, kind in enumerate(options.kinds.split(",")):
        (options.out / f"{kind}.txt").write_text(page(kind, options.first + number))
        print(kind, flush=True)


if __name__ == "__main__":
    main()
