"""Identify public records and print the results beside published figures.

    python -m benchmarks.records [--data FOLDER] [NAME ...]

FOLDER contains a folder for each record. The program names the absent ones and skips them.
"""

import argparse
import sys
from pathlib import Path

from benchmarks.records import bouc_wen, steering_mirror

RECORDS = (bouc_wen, steering_mirror)
DATA = Path(__file__).resolve().parents[3] / "shared" / "realdata"


def main(arguments: list[str] | None = None) -> int:
    """Print the table of every record that exists."""
    names = [record.NAME for record in RECORDS]
    parser = argparse.ArgumentParser(prog="python -m benchmarks.records", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(names))
    parser.add_argument("--data", type=Path, default=DATA, metavar="FOLDER")
    options = parser.parse_args(arguments)
    unknown = sorted(set(options.names) - set(names))
    if unknown:
        parser.error(f"no record {', '.join(unknown)}; there are {', '.join(names)}")
    for record in RECORDS:
        if options.names and record.NAME not in options.names:
            continue
        folder = options.data / record.FOLDER
        if not folder.is_dir():
            print(f"{record.NAME}: skipped, {folder} is absent. Name its parent with --data.")
            continue
        for line in record.report(folder):
            print(line, flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
