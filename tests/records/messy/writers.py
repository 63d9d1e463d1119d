"""Definition of a messy file, and writers that several files share.

``docs/messy_files.md`` lists the result of each file: its refusal, or the reported statements.
"""

import io
import struct
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import KW_ONLY, dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import openpyxl
import pandas as pd
from scipy.io import savemat

from tests.records.microscopes import write_ibw, write_jpk

SAMPLES = 400
RATE_Hz = 1000.0
EVERY = np.arange(SAMPLES)
TIME_s = EVERY / RATE_Hz
_noise = np.random.default_rng(42).normal(0, 0.003, SAMPLES)
VOLTAGE_V = np.round(50 + 40 * np.sin(2 * np.pi * 5 * TIME_s), 3)
POSITION_um = np.round(9 + 8 * np.sin(2 * np.pi * 5 * TIME_s - 0.2) + _noise, 4)
NAMES = ("time [s]", "voltage [V]", "position [um]")
AFTERNOON = datetime(2026, 3, 1, 14, 5, 3, 250000)
FULL_HOUR = datetime(2026, 3, 1, 14, 59, 59, 800000)
LATE = datetime(2026, 3, 1, 23, 59, 59, 800000)
LONG = 4096  # samples of the files whose rate changes

Write = Callable[[Path], None]


@dataclass(frozen=True)
class Messy:
    """A file with a fault.

    name       of the file; its suffix may matter
    fault      description for users
    write      writes the file
    true_rows  rows of the truth that a reading must give; none for other values
    breaks     number of breaks of the memory
    entry      lines of lab.toml with which the values are the true ones
    needs_clean_file  whether it is inspected together with a clean file
    """

    name: str
    fault: str
    write: Write
    _: KW_ONLY
    true_rows: np.ndarray = field(default_factory=lambda: EVERY)
    breaks: int = 0
    entry: str = ""
    needs_clean_file: bool = False


def columns(k: np.ndarray = EVERY) -> np.ndarray:
    return np.column_stack([TIME_s, VOLTAGE_V, POSITION_um])[k]


def lines(
    separator: str = ",",
    decimal: str = ".",
    *,
    table: np.ndarray | None = None,
    names: Sequence[str] = NAMES,
    written: Callable[[float], str] = "{:.4f}".format,
) -> list[str]:
    rows = columns() if table is None else table
    text = [[written(value).replace(".", decimal) for value in row] for row in rows]
    return [separator.join(names), *(separator.join(row) for row in text)]


def raw(content: bytes) -> Write:
    def write(path: Path) -> None:
        path.write_bytes(content)

    return write


def text(rows: Sequence[str], *, end: str = "\n", encoding: str = "utf-8") -> Write:
    return raw((end.join(rows) + end).encode(encoding))


def scaled(
    *factors: float,
    names: Sequence[str] = NAMES,
    written: Callable[[float], str] = "{:.4f}".format,
) -> Write:
    """Write the recording with each column multiplied by a factor."""
    return text(lines(table=columns() * factors, names=names, written=written))


def clocked(stamps: np.ndarray, written: Callable[[float], str] = "{:.4f}".format) -> Write:
    """Write the recording with other time stamps."""
    return text(lines(table=np.column_stack([stamps, VOLTAGE_V, POSITION_um]), written=written))


def with_rows(edit: Callable[[list[str]], list[str]], **options: object) -> Write:
    return text(edit(lines(**options)))  # type: ignore[arg-type]


def grouped(value: float, mark: str, decimal: str) -> str:
    return f"{value:,.2f}".replace(",", "_").replace(".", decimal).replace("_", mark)


def clock_of_day(k: int, mark: str = ".", start: datetime = AFTERNOON) -> str:
    instant = start + timedelta(seconds=float(TIME_s[k]))
    return instant.strftime("%H:%M:%S") + f"{mark}{instant.microsecond // 1000:03d}"


def stamped(stamps: Sequence[str], separator: str = ",", heading: str = "time") -> Write:
    rows = [row.split(",", 1)[1].replace(",", separator) for row in lines()[1:]]
    above = separator.join((heading, *NAMES[1:]))
    return text([above, *(separator.join(pair) for pair in zip(stamps, rows, strict=True))])


def instants(start: datetime) -> list[datetime]:
    return [start + timedelta(seconds=float(t)) for t in TIME_s]


def across_midnight() -> list[str]:
    return [f"{t:%d/%m/%Y %H:%M:%S}.{t.microsecond // 1000:03d}" for t in instants(LATE)]


def iso() -> list[str]:
    return [instant.isoformat() for instant in instants(LATE)]


def two_rates(path: Path) -> None:
    half = LONG // 2
    time_s = np.concatenate([np.arange(half) / 256, half / 256 + np.arange(half) / 2048])
    phase = 2 * np.pi * 2 * time_s
    noise = np.random.default_rng(5).normal(0, 0.003, LONG)
    table = np.column_stack([time_s, 50 + 40 * np.sin(phase), 9 + 8 * np.sin(phase - 0.2) + noise])
    text(lines(table=table, written="{:.9g}".format))(path)


def closed_loop_file(path: Path) -> None:
    time_s = np.arange(LONG) / RATE_Hz
    noise_um = np.random.default_rng(6).normal(0, 0.002, LONG)
    ramp = np.clip(time_s / 0.5, 0, 1)
    after_s = np.maximum(time_s - 0.5, 0)
    voltage_V = 10 + 50 * ramp - 1.5 * np.log1p(after_s / 0.05)
    table = np.column_stack([time_s, voltage_V, 2 + 10 * ramp + noise_um])
    text(lines(table=table, written="{:.6f}".format))(path)


def across_noon() -> list[str]:
    start = datetime(2026, 5, 4, 11, 59, 59, 800000)
    return [f"{t:%m/%d/%Y %I:%M:%S.%f %p}" for t in instants(start)]


def dated_array(path: Path) -> None:
    kinds = [("stamp", "M8[us]"), ("voltage_V", "f8"), ("position_um", "f8"), ("note", "U8")]
    table = np.zeros(SAMPLES, dtype=kinds)
    table["stamp"] = np.datetime64("2026-01-02T03:04:05") + (1e6 * TIME_s).astype("m8[us]")
    table["voltage_V"], table["position_um"], table["note"] = VOLTAGE_V, POSITION_um, "ok"
    np.save(path, table)


def dated_parquet(path: Path) -> None:
    index = pd.to_datetime("2026-01-02") + pd.to_timedelta(TIME_s, unit="s")
    frame = pd.DataFrame(dict(zip(NAMES[1:], columns()[:, 1:].T, strict=True)), index=index)
    frame.rename_axis("time").to_parquet(path)


def excel(cells: Callable[[object], None]) -> Write:
    def write(path: Path) -> None:
        book = openpyxl.Workbook()
        cells(book)
        book.save(path)

    return write


def plain_sheet(book: object) -> None:
    sheet = book.active  # type: ignore[attr-defined]
    sheet.append(NAMES)
    for row in columns().tolist():
        sheet.append(row)


def merged_cells(book: object) -> None:
    sheet = book.active  # type: ignore[attr-defined]
    sheet["A1"] = "Stage 42, after lunch"
    sheet.merge_cells("A1:C1")
    for row in ([], ["Zeit", "Spannung", "Weg"], ["s", "V", "µm"], *columns().tolist()):
        sheet.append(row)
    sheet.append(["mean", float(VOLTAGE_V.mean()), float(POSITION_um.mean())])


def computed_cells(book: object) -> None:
    sheet = book.active  # type: ignore[attr-defined]
    sheet.append(NAMES)
    for k, row in enumerate(columns().tolist()):
        sheet.append([*row[:2], f"=0.2*B{k + 2}"])


def second_sheet(book: object) -> None:
    sheet = book.active  # type: ignore[attr-defined]
    sheet.append(["operator", "Ada"])
    run = book.create_sheet("run 7")  # type: ignore[attr-defined]
    run.append(["stage 42"])
    run.append(NAMES)
    for row in columns().tolist():
        run.append(row)
    summary = book.create_sheet("summary")  # type: ignore[attr-defined]
    summary.append(["mean", 3.0, 4.0])
    summary.append(["std", 1.0, 2.0])


def cut_excel(path: Path) -> None:
    excel(plain_sheet)(path)
    path.write_bytes(path.read_bytes()[:4000])


def igor(path: Path) -> None:
    write_ibw(path, columns()[:, 1:], labels=NAMES[1:], step=1e3 / RATE_Hz, step_unit="ms")


def jpk(path: Path) -> None:
    write_jpk(path, [(SAMPLES / RATE_Hz, VOLTAGE_V, 1e-6 * POSITION_um)])


def empty_jpk(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("header.properties", "jpk-data-file=spm-forcefile\n")
        archive.writestr("segments/0/segment-header.properties", "")


def zipped_csv(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("run.csv", "\n".join(lines()))


def matlab(**variables: object) -> Write:
    def write(path: Path) -> None:
        savemat(path, variables)

    return write


def _element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + b"\0" * (-len(data) % 8)


def matlab_table(path: Path) -> None:
    """Write a timetable as MATLAB 5 does, as an opaque variable."""
    note, reference = io.BytesIO(), io.BytesIO()
    savemat(note, {"note": "made by hand"})
    savemat(reference, {"x": np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32)})
    flags = _element(6, struct.pack("<II", 17, 0))
    names = b"".join(_element(1, word) for word in (b"run", b"MCOS", b"timetable"))
    body = flags + names + reference.getvalue()[128:]
    path.write_bytes(note.getvalue() + _element(14, body))


def structured(path: Path) -> None:
    kinds = [(name, np.float64) for name in NAMES]
    table = np.array([tuple(row) for row in columns().tolist()], dtype=kinds)
    np.save(path, table)


def repeat_rows(rows: list[str]) -> list[str]:
    return [row for k, row in enumerate(rows) for _ in range(2 if 100 < k <= 160 else 1)]


def all_rows_but(*rows: int) -> np.ndarray:
    return np.setdiff1d(EVERY, rows)


COUNTS = "scale = { displacement = 1e-10 }\n"
UNITS = 'units = { time = "s", voltage = "V", displacement = "um" }\n'
BY_NUMBER = "columns = { time = 1, voltage = 2, displacement = 3 }\n" + UNITS
