"""Read sealed files of a stage back into records.

A sealed file is JSON with its schema and a digest of its content; the same record, the same bytes.
"""

from collections.abc import Callable, Mapping, Sequence
from json import JSONDecodeError, loads
from pathlib import Path

import piezoid.diagnosis.effects  # noqa: F401 - defines the extensions of some models
from piezoid.design.design import Design, design_from_json
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.export import parameter_file
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification import store
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.store import write_model
from piezoid.learning.learn import Learned, learned_from_json
from piezoid.records.lab import Lab, read_lab
from piezoid.verification.verification import Verification, verification_from_json

Place = str | Path
Sealed = (
    ActuatorModel
    | Diagnosis
    | tuple[Diagnosis, ...]
    | Design
    | ParameterFile
    | Verification
    | Learned
)


def load(path: Place) -> Sealed:
    """Read a sealed file of any schema back; for a folder, its model.json.

    returned  of model.json an ActuatorModel, of diagnosis.json a tuple with the diagnosis of each
              axis, of design.json a Design, of params.json a ParameterFile, of verification.json
              a Verification, of learning.json a Learned

    Raises ``ParameterFileError`` where a bit was changed or the file is none of these, and
    ``OSError`` where it cannot be read.

    >>> piezoid.save(model, "model.json")
    >>> piezoid.load("model.json").stage == model.stage
    True
    """
    file = path_of(path)
    file = file / "model.json" if file.is_dir() else file
    content = file.read_bytes()
    try:
        record = loads(content)
        schema = str(record.get("schema")) if isinstance(record, dict) else ""
    except (JSONDecodeError, UnicodeDecodeError, RecursionError):
        schema = ""
    kind = schema.partition("/")[0]
    if kind not in _READERS:
        raise ParameterFileError(
            f"{file.name} is of {f'schema {schema!r}' if schema else 'no schema'}",
            needed=f"one of {', '.join(_READERS)}",
            remedy="Pass model.json, diagnosis.json, design.json, params.json, "
            "verification.json or learning.json of a stage's folder.",
        )
    return _READERS[kind](content, str(file))


def read_model(content: bytes, location: str = "model.json") -> ActuatorModel:
    """Read model.json, including extensions that effects define.

    Raises ``ParameterFileError`` as ``store.read_model``.
    """
    return store.read_model(content, location)


_READERS: Mapping[str, Callable[[bytes, str], Sealed]] = {
    "piezoid.model": read_model,
    "piezoid.diagnosis": read_diagnoses,
    "piezoid.design": design_from_json,
    "piezoid.params": parameter_file.from_json,
    "piezoid.verification": verification_from_json,
    "piezoid.learning": learned_from_json,
}


def save(record: Sealed | Sequence[Diagnosis], path: Place) -> None:
    """Write a record into its sealed file; ``load`` reads it back, number for number.

    record  an ActuatorModel, a Diagnosis or several, a Design, a ParameterFile, a Verification,
            a Learned

    >>> piezoid.save(design, "design.json")
    >>> type(piezoid.load("design.json")).__name__
    'Design'
    """
    path_of(path).write_bytes(sealed(record))


def sealed(record: object) -> bytes:
    """Return the bytes of a record's sealed file; the same record, the same bytes."""
    if isinstance(record, ActuatorModel):
        return write_model(record)
    if isinstance(record, Diagnosis):
        return write_diagnosis(record)
    if isinstance(record, Design | Verification | Learned):
        return record.to_json()
    if isinstance(record, ParameterFile):
        return parameter_file.to_json(record)
    several = tuple(record) if isinstance(record, tuple | list) else ()
    if several and all(isinstance(part, Diagnosis) for part in several):
        return write_diagnosis(several[0], further_axes=several[1:])
    raise ParameterFileError(
        f"{type(record).__name__} has no sealed file",
        needed="an ActuatorModel, a Diagnosis, a Design, a ParameterFile, a Verification or a "
        "Learned",
        remedy="Save what a Shipping holds: its parameters and its verification.",
    )


def digest_of(record: object) -> str:
    """Return the digest in a record's sealed file."""
    return str(loads(sealed(record))["digest"])


def path_of(path: object) -> Path:
    """Convert to a path, or raise ``RecordingError`` for other types."""
    if isinstance(path, str | Path):
        return Path(path)
    raise RecordingError(
        f"{type(path).__name__} given for a file",
        needed="the path of a file",
        remedy="Pass a string or a pathlib.Path.",
    )


def lab_of(lab: object) -> Lab | None:
    """Return a ``Lab`` unchanged, or read it from its path; None stays None."""
    return lab if lab is None or isinstance(lab, Lab) else read_lab(path_of(lab))
