"""Read and write the sealed files of a stage.

A sealed file is JSON with its schema and a digest. The same record gives the same bytes.
"""

from collections.abc import Callable, Mapping, Sequence
from json import JSONDecodeError, loads
from pathlib import Path

import piezoid.diagnosis.effects  # noqa: F401 - defines the extensions of some models
from piezoid.design.design import Design, design_from_json
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.sealed_diagnosis import read_diagnoses, write_diagnosis
from piezoid.digests import digest_in
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.export import parameter_file
from piezoid.export.parameter_file import ParameterFile
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.store import read_model as read_model
from piezoid.identification.store import write_model
from piezoid.learning.learn import Learned, learned_from_json
from piezoid.records.lab import Lab, read_lab
from piezoid.verification.verification import Verification, verification_from_json

FilePath = str | Path
Sealed = (
    ActuatorModel
    | Diagnosis
    | tuple[Diagnosis, ...]
    | Design
    | ParameterFile
    | Verification
    | Learned
)


def load(path: FilePath) -> Sealed:
    """Return the record of a sealed file; for a folder, of its model.json.

    returned  ActuatorModel for model.json, a tuple with the Diagnosis of each axis for
              diagnosis.json, Design for design.json, ParameterFile for params.json, Verification
              for verification.json, Learned for learning.json

    Raises ``ParameterFileError`` for a wrong digest or another schema, and ``OSError`` if the file
    cannot be read.

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
            f"{file.name} has {f'schema {schema!r}' if schema else 'no schema'}",
            needed=f"one of {', '.join(_READERS)}",
            remedy="Pass model.json, diagnosis.json, design.json, params.json, "
            "verification.json or learning.json.",
        )
    return _READERS[kind](content, str(file))


_READERS: Mapping[str, Callable[[bytes, str], Sealed]] = {
    "piezoid.model": read_model,
    "piezoid.diagnosis": read_diagnoses,
    "piezoid.design": design_from_json,
    "piezoid.params": parameter_file.from_json,
    "piezoid.verification": verification_from_json,
    "piezoid.learning": learned_from_json,
}


def save(record: Sealed | Sequence[Diagnosis], path: FilePath) -> None:
    """Write a record to a sealed file, from which ``load`` restores the exact numbers.

    record  an ActuatorModel, one or several Diagnosis records, a Design, a ParameterFile, a
            Verification, or a Learned

    >>> piezoid.save(design, "design.json")
    >>> type(piezoid.load("design.json")).__name__
    'Design'
    """
    path_of(path).write_bytes(sealed(record))


def sealed(record: object) -> bytes:
    """Return the content of the sealed file of a record."""
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
        f"a {type(record).__name__} has no sealed file",
        needed="an ActuatorModel, a Diagnosis, a Design, a ParameterFile, a Verification or a "
        "Learned",
        remedy="Of a Shipping, save its parameters and its verification.",
    )


def digest_of(record: object) -> str:
    """Return the digest in the sealed file of a record."""
    return digest_in(sealed(record))


def path_of(path: object) -> Path:
    """Convert to a path, or raise ``RecordingError`` for other types."""
    if isinstance(path, str | Path):
        return Path(path)
    raise RecordingError(
        f"{type(path).__name__} given as a path",
        needed="the path of a file",
        remedy="Pass a string or a pathlib.Path.",
    )


def lab_of(lab: object) -> Lab | None:
    """Return a ``Lab`` unchanged, or read it from its path; None stays None."""
    return lab if lab is None or isinstance(lab, Lab) else read_lab(path_of(lab))
