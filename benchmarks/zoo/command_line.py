"""Arguments and result files that the benchmarks on stages of the zoo share."""

import argparse
import json
from pathlib import Path
from typing import Any


def stage_parser(description: str | None, *, cases: int, first: int) -> argparse.ArgumentParser:
    """Return a parser with the number of stages and their first seed."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=cases, help="stages of each law and kind")
    parser.add_argument("--seeds", type=int, default=first, help="the first seed")
    return parser


def add_results(parser: argparse.ArgumentParser, path: str) -> None:
    """Add the arguments of a benchmark whose results file a later run continues."""
    parser.add_argument("--json", type=Path, default=Path(path), help="results file")
    parser.add_argument("--minutes", type=float, default=1e9, help="start no stage after this")


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the rows of a results file, and create its folder.

    A last line that an interrupted run left incomplete is removed from the file.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    text = path.read_text() if path.exists() else ""
    complete = text[: text.rfind("\n") + 1]
    if complete != text:
        path.write_text(complete)
    return [json.loads(line) for line in complete.splitlines()]
