"""Everything that reads, with a first input for each: formats, lab.toml, limits, sealed files."""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from piezoid.design.design import design_from_json
from piezoid.design.specification import Specification, specifications_from_toml
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.export.parameter_file import from_json, to_json
from piezoid.identification.store import read_model, write_model
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import read_lab
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
ASKED = {
    "x": Specification(
        bandwidth_Hz=90.0, delay_margin_s=5e-5, voltage_min_V=-10.0, voltage_max_V=10.0,
        sensor_noise_rms=1e-9, scan_frequency_Hz=10.0, disturbance_rms=1e-7,
    )
}  # fmt: skip
LAB = Path(__file__).parents[1] / "datasets" / "lab.toml"


def answer_to_recording(place: Path) -> str:
    """Read a recording the whole way; an inspection holds its refusal."""
    (found, *_) = inspect_files([place])
    if found.refusal:
        return f"{REFUSED} {found.refusal}"
    return " ".join((found.format or "", *(statement.quantity for statement in found.statements)))


def sealed_readers() -> dict[str, tuple[Callable[[bytes, str], Any], Callable[[Any], bytes]]]:
    """Return what reads each sealed file, and what writes again what was read."""
    return {
        "model.json": (read_model, write_model),
        "diagnosis.json": (read_diagnoses, _diagnosis_again),
        "design.json": (design_from_json, lambda design: design.to_json()),
        "params.json": (from_json, to_json),
        "verification.json": (verification_from_json, lambda found: found.to_json()),
        "batch.json": (stage_from_json, lambda stage: stage.to_json()),
    }


def _diagnosis_again(found: tuple[Diagnosis, ...]) -> bytes:
    return write_diagnosis(found[0], further_axes=found[1:])


def targets(folder: Path, given: Path | None) -> dict[str, tuple[bytes, Callable[[Path], str]]]:
    """Return a first input and the reader of every kind of file."""
    found: dict[str, tuple[bytes, Callable[[Path], str]]] = {}
    for name, write in samples().items():
        write(folder / name)
        found[name] = ((folder / name).read_bytes(), answer_to_recording)
    found["lab.toml"] = (LAB.read_bytes(), lambda place: str(len(read_lab(place).recordings)))
    found["lab and run.csv"] = (
        LAB_OF_RUN,
        lambda place: _answer_with_lab(place, folder / "run.csv"),
    )
    wanted = b"[x]\nbandwidth_Hz = 120\n[[x.template]]\nname = 'a'\nfunction = 'Syp'\n"
    wanted += b"frequency_Hz = [500, 800]\nupper_dB = [3, 3]\n"
    found["design.toml"] = (
        wanted,
        lambda p: str(specifications_from_toml(p.read_text("utf-8"), ASKED)),
    )
    limits = b"aligned_percent = 0.5\njudged_Hz = 20\n"
    found["limits.toml"] = (limits, lambda p: str(limits_from_toml(p.read_text("utf-8"), p.name)))
    known = {"model.json": write_model(stage_model(axis_model())), "params.json": to_json(stage())}
    for name, reader in sealed_readers().items():
        held = known.get(name, b"")
        if given is not None and (given / name).exists():
            held = (given / name).read_bytes()
        held = held or corpus(name).get("first", b"")
        if held:
            found[name] = (held, _answer_to_sealed(*reader))
    return found


def _answer_with_lab(place: Path, recording: Path) -> str:
    """Read a recording as a lab.toml says it is to be read."""
    given = recording.with_name("lab.toml")
    given.write_bytes(place.read_bytes())
    (found, *_) = inspect_files([recording], read_lab(given))
    if found.refusal:
        return f"{REFUSED} {found.refusal}"
    return " ".join(statement.quantity for statement in found.statements)


def corpus(name: str) -> dict[str, bytes]:
    """Return the inputs that are kept for a target."""
    if not CORPUS.exists():
        return {}
    with zipfile.ZipFile(CORPUS) as archive:
        held = [m for m in archive.namelist() if m.startswith(f"{name}/")]
        return {member.partition("/")[2]: archive.read(member) for member in held}


def _answer_to_sealed(
    reader: Callable[[bytes, str], Any], writer: Callable[[Any], bytes]
) -> Callable[[Path], str]:
    def answer(place: Path) -> str:
        writer(reader(place.read_bytes(), place.name))  # what is taken must be whole enough for it
        return "read"

    return answer
