"""A recording as a text file, a lab.toml with its entry, statements and the refusal of a file."""

from pathlib import Path

import numpy as np

from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, RecordingEntry
from piezoid.records.recording import Recording
from piezoid.statement import Statement

RATE_Hz = 1000.0
SAMPLES = 400
TIME_s = np.arange(SAMPLES) / RATE_Hz
VOLTAGE_V = 50 + 40 * np.sin(2 * np.pi * 7 * TIME_s)
RESPONSE = 3 * np.sin(2 * np.pi * 7 * TIME_s - 0.1) + 0.2 * TIME_s
HEADINGS = "time [s],voltage [V],position [um]"
ROWS = "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(60))  # below these headings


def table(folder: Path, headings: str, *columns: np.ndarray, name: str = "run.csv") -> Path:
    rows = np.column_stack(columns)
    lines = [",".join("" if np.isnan(v) else f"{v:.9g}" for v in row) for row in rows]
    path = folder / name
    path.write_text("\n".join([headings, *lines]) + "\n")
    return path


def lab_with(file: str = "run.csv", **entry: object) -> Lab:
    return Lab(recordings=(RecordingEntry(file=file, **entry),))  # type: ignore[arg-type]


def refusal_of(path: Path) -> str:
    """Return the refusal of a file by an inspection, or an empty text."""
    (inspection, *_) = inspect_files([path])
    return inspection.refusal or ""


def statements_of(recording: Recording, quantity: str) -> list[Statement]:
    """Return the statements about a recording with this quantity."""
    return [s for s in recording.statements if s.quantity == quantity]


def quantities_of(recording: Recording) -> set[str]:
    """Return the quantities of all statements about a recording."""
    return {s.quantity for s in recording.statements}
