"""One known recording, written in every format piezoid reads."""

import gzip
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import h5py
import numpy as np
import pyarrow as pa
from nptdms import ChannelObject, TdmsWriter
from pyarrow.parquet import write_table
from scipy.io import savemat

SAMPLES = 200
RATE_Hz = 2000.0
TIME_s = np.arange(SAMPLES) / RATE_Hz
VOLTAGE_V = np.round(40 + 30 * np.sin(2 * np.pi * 17 * TIME_s), 4)
DISPLACEMENT_um = np.round(9 + 6 * np.sin(2 * np.pi * 17 * TIME_s - 0.2) + 0.01 * TIME_s, 5)
COLUMNS = np.column_stack([TIME_s, VOLTAGE_V, DISPLACEMENT_um])
NAMES = ("time [s]", "voltage [V]", "displacement [um]")


def _rows(separator: str, decimal: str = ".", columns: np.ndarray = COLUMNS) -> str:
    lines = [separator.join(f"{value:.6f}" for value in row) for row in columns]
    return "\n".join(lines).replace(".", decimal) + "\n"


def csv(path: Path) -> None:
    path.write_text(",".join(NAMES) + "\n" + _rows(","))


def csv_gz(path: Path) -> None:
    path.write_bytes(gzip.compress((",".join(NAMES) + "\n" + _rows(",")).encode(), mtime=0))


def tsv_comma(path: Path) -> None:
    path.write_text("Stage 42\nOperator\tcafé\n\n" + "\t".join(NAMES) + "\n" + _rows("\t", ","))


def semicolons(path: Path) -> None:
    above = "Zeit;Spannung;Weg\n(s);(V);(µm)\n\n"
    path.write_bytes((above + _rows(";", ",")).encode("latin-1"))


def blanks(path: Path) -> None:
    path.write_text("# rig 3\n# time [s]   Voltage (V)  Position_um\n" + _rows("  "))


def npz(path: Path) -> None:
    np.savez(path, time_s=TIME_s, voltage_V=VOLTAGE_V, displacement_um=DISPLACEMENT_um)


def mat5(path: Path) -> None:
    inner = {"voltage_V": VOLTAGE_V, "displacement_um": DISPLACEMENT_um[:, None]}
    savemat(path, {"time_s": TIME_s, "stage": inner, "comment": "triangle"}, do_compression=True)


def mat73(path: Path) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in columns_by_name().items():
            dataset = file.create_dataset(name, data=values[None, :])
            dataset.attrs["MATLAB_class"] = np.bytes_("double")
    content = bytearray(path.read_bytes())
    content[:128] = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path.write_bytes(bytes(content))


def columns_by_name() -> dict[str, np.ndarray]:
    return {"time_s": TIME_s, "voltage_V": VOLTAGE_V, "displacement_um": DISPLACEMENT_um}


def hdf5(path: Path) -> None:
    with h5py.File(path, "w") as file:
        group = file.create_group("run 1")
        for (name, values), unit in zip(columns_by_name().items(), ("s", "V", "um"), strict=True):
            group.create_dataset(name.rsplit("_", 1)[0], data=values).attrs["unit"] = unit


def parquet(path: Path) -> None:
    write_table(pa.table(dict(zip(NAMES, COLUMNS.T, strict=True))), path)


def tdms(path: Path) -> None:
    clock = {"wf_increment": 1 / RATE_Hz, "wf_start_offset": 0.0}
    with TdmsWriter(path) as writer:
        drive = ChannelObject("x", "voltage", VOLTAGE_V, {**clock, "unit_string": "V"})
        um = {**clock, "unit_string": "um"}
        writer.write_segment([drive, ChannelObject("stage", "position", DISPLACEMENT_um, um)])


def lvm(path: Path) -> None:
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\n"
        "Decimal_Separator\t,\nMulti_Headings\tYes\nX_Columns\tNo\n***End_of_Header***\t\n\t\n"
        f"Channels\t2\t\t\nSamples\t{SAMPLES}\t{SAMPLES}\t\nY_Unit_Label\tVolts\tmicrometers\t\n"
        "X_Dimension\tTime\tTime\t\nX0\t0,0E+0\t0,0E+0\t\nDelta_X\t5,0E-4\t5,0E-4\t\n"
        "***End_of_Header***\t\t\t\nX_Value\tVoltage\tPosition\tComment\n"
    )
    rows = _rows("\t", ",", COLUMNS[:, 1:]).splitlines()
    path.write_text(head + "".join(f"\t{row}\n" for row in rows))


def nanonis(path: Path) -> None:
    above = "Experiment\tHistory\t\nDate\t01.01.2015 10:00:00\t\n\n[DATA]\n"
    heading = "Time (s)\tVoltage (V)\tPosition (m)\n"
    scaled = COLUMNS * [1, 1, 1e-6]
    rows = "".join("\t".join(f"{value:.9E}" for value in row) + "\n" for row in scaled)
    path.write_text(above + heading + rows)


def rigol(path: Path) -> None:
    above = f"X,CH1,CH2,Start,Increment,\nSequence,Volt,Volt,-1.0e-2,{1 / RATE_Hz:e},\n"
    rows = [f"{k},{v:e},{d / 10:e},,\n" for k, (_, v, d) in enumerate(COLUMNS)]
    path.write_text(above + "".join(rows))


def tektronix(path: Path) -> None:
    settings = [
        ("Record Length", f"{SAMPLES:e}"),
        ("Sample Interval", f"{1 / RATE_Hz:e}"),
        ("Source", "{}"),
        ("Vertical Units", "V"),
        ("Horizontal Units", "s"),
    ]
    settings += [("", "")] * (SAMPLES - len(settings))
    lines = []
    for (key, value), (t, v, d) in zip(settings, COLUMNS, strict=True):
        parts = (("CH1", v), ("CH2", d / 10))
        cells = [f"{key},{value.format(name)},,{t:.9f},{y:.7f}," for name, y in parts]
        lines.append(",".join(cells))
    path.write_text("\n".join(lines) + "\n")


def tektronix_above(path: Path) -> None:
    above = "Model,MSO\n\nHorizontal Units,S,\nVertical Units,V,V\nLabel,,\nTIME,CH1,CH2\n"
    path.write_text(above + _rows(",", ".", COLUMNS * [1, 1, 0.1]))


def logger(path: Path) -> None:
    start = datetime(2024, 2, 28, 23, 59, 59, 950000, tzinfo=UTC)
    lines = ["date,voltage [V],position [um],state"]
    for t, v, d in COLUMNS:
        stamp = (start + timedelta(seconds=t)).isoformat(timespec="microseconds")
        lines.append(f"{stamp},{v:.6f},{d:.6f},ok")
    path.write_text("\n".join(lines) + "\n")


def gcs(path: Path) -> None:
    above = (
        f"# VERSION = 1\n# TYPE = 1\n# SEPARATOR = 9\n# DIM = 2\n# NDATA = {SAMPLES}\n"
        f"# SAMPLE_TIME = {1 / RATE_Hz}\n# NAME0 = Control Voltage [V]\n"
        "# NAME1 = Actual Position [um]\n# END_HEADER\n"
    )
    path.write_text(above + _rows("\t", ".", COLUMNS[:, 1:]))


def npy(path: Path) -> None:
    np.save(path, COLUMNS)


# Files whose headings suffice.
DESCRIBED: dict[str, Callable[[Path], None]] = {
    "run.csv": csv,
    "run.csv.gz": csv_gz,
    "run.tsv": tsv_comma,
    "german.csv": semicolons,
    "run.txt": blanks,
    "run.npz": npz,
    "run5.mat": mat5,
    "run73.mat": mat73,
    "run.h5": hdf5,
    "run.parquet": parquet,
    "run.tdms": tdms,
    "run.lvm": lvm,
    "history.dat": nanonis,
    "recorder.dat": gcs,
    "logger.csv": logger,
}
# Files that need lab.toml.
UNDESCRIBED: dict[str, Callable[[Path], None]] = {
    "rigol.csv": rigol,
    "tek.csv": tektronix,
    "tek2.csv": tektronix_above,
    "run.npy": npy,
}
