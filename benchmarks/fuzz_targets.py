"""Targets of the fuzzers: every reader with a valid input (recordings, TOML, sealed files)."""

import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from piezoid.design.design import design_from_json
from piezoid.design.specification import Specification, specifications_from_toml
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.export.parameter_file import from_json, to_json
from piezoid.identification.store import read_model, write_model
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, read_lab
from piezoid.verification.criteria import limits_from_toml
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import stage_from_json
from tests.export.stage import stage
from tests.records.messy.samples import samples
from tests.reports.known_stage import axis_model, stage_model

REFUSED = "refused:"
CORPUS = Path(__file__).parents[1] / "tests" / "records" / "corpus.zip"
LAB_OF_RUN = b"""[acquisition]
sampling_rate_Hz = 2000
[[recording]]
file = "run.csv"
axis = "x"
sampling_rate_Hz = 2e3
start_s = 0.01
stop_s = 0.08
columns = { time = "time [s]", voltage = 2, displacement = "displacement" }
units = { voltage = "mV", displacement = "nm" }
"""
SPECIFICATIONS = {
    "x": Specification(
        bandwidth_Hz=90.0, delay_margin_s=5e-5, voltage_min_V=-10.0, voltage_max_V=10.0,
        sensor_noise_rms=1e-9, scan_frequency_Hz=10.0, disturbance_rms=1e-7,
    )
}  # fmt: skip
LAB = Path(__file__).parents[1] / "datasets" / "lab.toml"


SEALED_FILES: dict[str, tuple[Callable[[bytes, str], Any], Callable[[Any], bytes]]] = {
    "model.json": (read_model, write_model),
    "diagnosis.json": (
        read_diagnoses,
        lambda axes: write_diagnosis(axes[0], further_axes=axes[1:]),
    ),
    "design.json": (design_from_json, lambda design: design.to_json()),
    "params.json": (from_json, to_json),
    "verification.json": (verification_from_json, lambda verification: verification.to_json()),
    "batch.json": (stage_from_json, lambda stage: stage.to_json()),
}


def targets(folder: Path, stage_folder: Path | None) -> dict[str, tuple[bytes, Callable]]:
    """Return a valid input and a reader for every type of file.

    stage_folder  output of `piezoid fit`, whose sealed files replace the built-in ones
    """
    readers: dict[str, tuple[bytes, Callable[[Path], str]]] = {}
    for name, write in samples().items():
        write(folder / name)
        readers[name] = (
            (folder / name).read_bytes(),
            lambda path: _inspect(path, has_format=True),
        )
    readers["lab.toml"] = (LAB.read_bytes(), lambda path: str(len(read_lab(path).recordings)))
    readers["lab and run.csv"] = (LAB_OF_RUN, lambda path: _inspect_with_lab(path, folder))
    design = b"[x]\nbandwidth_Hz = 120\n[[x.template]]\nname = 'a'\nfunction = 'Syp'\n"
    design += b"frequency_Hz = [500, 800]\nupper_dB = [3, 3]\n"
    readers["design.toml"] = (
        design,
        lambda path: str(specifications_from_toml(path.read_text("utf-8"), SPECIFICATIONS)),
    )
    limits = b"aligned_percent = 0.5\njudged_Hz = 20\n"
    readers["limits.toml"] = (
        limits,
        lambda path: str(limits_from_toml(path.read_text("utf-8"), path.name)),
    )
    built_in = {
        "model.json": write_model(stage_model(axis_model())),
        "params.json": to_json(stage()),
    }
    for name, functions in SEALED_FILES.items():
        content = built_in.get(name, b"")
        if stage_folder is not None and (stage_folder / name).exists():
            content = (stage_folder / name).read_bytes()
        content = content or corpus(name).get("first", b"")
        if content:
            readers[name] = (content, partial(_read_and_write, *functions))
    return readers


def _inspect(path: Path, lab: Lab | None = None, *, has_format: bool = False) -> str:
    """Read a recording completely; return its refusal, or its format and its statements."""
    (inspection, *_) = inspect_files([path], lab)
    if inspection.refusal:
        return f"{REFUSED} {inspection.refusal}"
    words = [inspection.format or ""] if has_format else []
    return " ".join((*words, *(statement.quantity for statement in inspection.statements)))


def _inspect_with_lab(path: Path, folder: Path) -> str:
    """Read run.csv with the lab.toml under test."""
    lab = folder / "lab.toml"
    lab.write_bytes(path.read_bytes())
    return _inspect(folder / "run.csv", read_lab(lab))


def _read_and_write(
    reader: Callable[[bytes, str], Any], writer: Callable[[Any], bytes], path: Path
) -> str:
    """Read a sealed file and write its record again: an accepted record must be complete."""
    writer(reader(path.read_bytes(), path.name))
    return "read"


def corpus(name: str) -> dict[str, bytes]:
    """Return the stored inputs of a target."""
    if not CORPUS.exists():
        return {}
    with zipfile.ZipFile(CORPUS) as archive:
        members = [m for m in archive.namelist() if m.startswith(f"{name}/")]
        return {member.partition("/")[2]: archive.read(member) for member in members}
