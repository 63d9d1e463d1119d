"""Hurried recordings of an outsider: what inspect and fit say, beside what a physicist would.

    python -m benchmarks.outsiders.told [--first 101] [--kinds a,b] --out FOLDER

Writes a page of text for each kind: the verdict, what must and must not be conveyed, and the words
of both verbs. Whether they agree is for a reader to judge.
"""

import argparse
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parent / "dogwood"))
import recordings  # the outsider's files find each other by their folder


def page(kind: str, seed: int) -> str:
    """Write one case, ask both verbs, and return what is to be compared."""
    with TemporaryDirectory() as scratch:
        place = Path(scratch)
        told = recordings.write(kind, seed, place)
        files, lab = sorted(place.glob("*.csv")), place / "lab.toml"
        declared = ["--lab", lab] if lab.exists() else []
        parts = [
            f"{kind}, seed {seed}",
            told["verdict"],
            *(f"must: {one}" for one in told["must"]),
            *(f"must not: {one}" for one in told["must_not"]),
            _said("inspect", *files, *declared),
            _said("fit", *files, *declared, "--out", place / "stage"),
        ]
    return "\n".join(parts)


def _said(verb: str, *words: object) -> str:
    own = Path(sys.executable).with_name("piezoid")
    done = subprocess.run([str(own), verb, *map(str, words)], capture_output=True, text=True)
    return f"--- {verb}, status {done.returncode}\n{done.stdout}{done.stderr}"


def main() -> None:
    """Write the pages."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--kinds", default=",".join(recordings.cases()))
    parser.add_argument("--out", type=Path, required=True)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    for number, kind in enumerate(asked.kinds.split(",")):
        (asked.out / f"{kind}.txt").write_text(page(kind, asked.first + number))
        print(kind, flush=True)


if __name__ == "__main__":
    main()
