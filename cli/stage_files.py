"""Sealed files of one stage: read them, and refuse files of different models."""

from collections.abc import Mapping
from functools import cached_property
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

from piezoid.digests import digest_in
from piezoid.errors import LabFileError, ParameterFileError
from piezoid.manifest import is_as_written

if TYPE_CHECKING:
    from piezoid.design.design import Design
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.identification.actuator_model import ActuatorModel
    from piezoid.records.lab import Lab

LAB = "lab.toml"
WRITTEN_BY = {
    "model.json": "piezoid fit RECORDINGS --out {}",
    "diagnosis.json": "piezoid fit RECORDINGS --out {}",
    "design.json": "piezoid design {}",
    "params.json": "piezoid export {}",
    "verification.json": "piezoid verify {}",
}
_MAX_bytes = 1 << 27  # a hundred times the size for a stage of many recordings


class StageFolder:
    """Sealed files of a stage, each read at its first use."""

    def __init__(self, folder: Path, lab: Path | None = None) -> None:
        """Set the folder, and a lab.toml other than the one in the folder."""
        self.folder, self._lab = folder, lab

    @cached_property
    def lab(self) -> "Lab | None":
        """The content of lab.toml, or None without one."""
        from piezoid.records.lab import read_lab

        path = self.folder / LAB if self._lab is None else self._lab
        return read_lab(path) if self._lab is not None or path.exists() else None

    @cached_property
    def model_json(self) -> bytes:
        """Content of model.json."""
        return content_of(self.folder / "model.json")

    @cached_property
    def model(self) -> "ActuatorModel":
        """The fitted stage."""
        from piezoid.sealed_files import read_model

        return read_model(self.model_json, str(self.folder / "model.json"))

    @property
    def model_digest(self) -> str:
        """Digest of model.json."""
        return digest_in(self.model_json)

    @cached_property
    def design(self) -> "Design":
        """The controllers; raises ``ParameterFileError`` if they are of another model."""
        from piezoid.design.design import design_from_json

        path = self.folder / "design.json"
        design = design_from_json(content_of(path), str(path))
        self._check_model(design.model_digest, "design.json", "piezoid design")
        return design

    @cached_property
    def parameters(self) -> "ParameterFile":
        """The shipped parameters; raises ``ParameterFileError`` if they are of another model."""
        from piezoid.export.parameter_file import from_json

        path = self.folder / "params.json"
        parameters = from_json(content_of(path), str(path))
        self._check_model(parameters.sources.get("model", ""), "params.json", "piezoid export")
        return parameters

    def _check_model(self, digest: str, name: str, verb: str) -> None:
        """Refuse a file that was made from another model.json; ``verb`` writes it again."""
        if digest != self.model_digest:
            raise ParameterFileError(
                f"{name} was made from the model {digest[:19]}..., but model.json is "
                f"{self.model_digest[:19]}...",
                needed="files of the same model",
                remedy=f"Run `{verb}` again, then the commands that follow it.",
            )


def content_of(path: Path) -> bytes:
    """Return the content of a sealed file; raise ``OSError`` for a pipe or a device."""
    from piezoid.records.readers.reader import regular_size

    try:
        size = regular_size(path)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise _missing(path) from error
    if size > _MAX_bytes:
        raise ParameterFileError(
            f"{path} has {size} bytes",
            needed=f"at most {_MAX_bytes}; piezoid does not write larger files",
            remedy="Use the original, or run the command that wrote it again.",
        )
    with path.open("rb") as stream:
        return stream.read(size)


def _missing(path: Path) -> ParameterFileError:
    """Return the error about a missing folder or file, with the verb that writes it."""
    folder = path.parent
    if path.name not in WRITTEN_BY:
        return ParameterFileError(
            f"{path} does not exist",
            needed="a readable file",
            remedy="Check its name.",
        )
    if not folder.is_dir():
        return ParameterFileError(
            f"{folder} {'is a file' if folder.exists() else 'does not exist'}",
            needed="the folder of a stage, as `piezoid fit` writes it",
            remedy="Check its name, or create it: piezoid fit RECORDINGS --out FOLDER",
        )
    if path.name == "params.json" and (folder / "refused").is_dir():
        return ParameterFileError(
            f"{folder} contains no controller, because its design failed its verification",
            needed="a controller that passed",
            remedy=f"Read the failed checks in {folder / 'refused' / 'verification.json'}, "
            "record the effects that the model lacks, and fit again.",
        )
    is_fitted, is_designed = ((folder / name).exists() for name in ("model.json", "design.json"))
    if path.name in ("params.json", "design.json") and is_fitted and not is_designed:
        return ParameterFileError(
            f"{folder} contains no controller: the fit designed none",
            needed="a design of the stage",
            remedy=f"Run `piezoid design {folder}`, which states what is missing.",
        )
    remedy = f"Run `{WRITTEN_BY[path.name].format(folder)}` first."
    return ParameterFileError(
        f"{folder} contains no {path.name}",
        needed=f"the folder of a stage with {path.name}",
        remedy=remedy if is_fitted else f"Name the folder that `piezoid fit` wrote. {remedy}",
    )


def changed_in_bundle(stage: Path, file: "ParameterFile") -> tuple[str, ...]:
    """Return the files of bundle/ that are missing or differ from those of params.json."""
    from piezoid.export.bundle import bundle

    return tuple(
        name
        for name, content in bundle(file).items()
        if not (path := stage / "bundle" / name).is_file() or content_of(path) != content
    )


def out_of_date(stage: StageFolder, contents: Mapping[str, bytes]) -> dict[str, str]:
    """Return the sealed files made from other files than those in the folder, with the reasons.

    contents  of the sealed files of a stage, by name
    """
    from piezoid.export.parameter_file import from_json

    folder, stale = stage.folder, {}
    digests = {name: digest_in(content) for name, content in contents.items()}
    if "diagnosis.json" in contents and not is_as_written(folder / "diagnosis.json"):
        stale["diagnosis.json"] = f"not from this fit; run piezoid fit RECORDINGS --out {folder}"
    if "params.json" in contents:
        file = from_json(contents["params.json"], str(folder / "params.json"))
        other_sources = [
            name
            for name, key in (("model.json", "model"), ("design.json", "design"))
            if name in digests and digests[name] != file.sources.get(key)
        ]
        if other_sources:
            stale["params.json"] = (
                f"exported from another {other_sources[0]}; run piezoid export {folder}"
            )
        elif changed := changed_in_bundle(folder, file):
            stale["verification.json"] = (
                f"bundle/{changed[0]} is missing or changed; run piezoid export {folder}"
            )
    if "design.json" in contents and stage.lab is not None:
        rig = str(loads(contents["design.json"]).get("rig_digest"))
        if rig not in ("", stage.lab.rig_digest):
            stale["verification.json"] = (
                f"the rig in {stage.lab.place} was changed; run piezoid design {folder}, then "
                f"piezoid export {folder}"
            )
    if "verification.json" in contents:
        refused = folder / "refused" / "params.json"
        refused_digest = digest_in(content_of(refused)) if refused.is_file() else ""
        verified = str(loads(contents["verification.json"]).get("parameters_digest"))
        if "params.json" in stale or verified != digests.get("params.json", refused_digest):
            stale["verification.json"] = f"from another params.json; run piezoid export {folder}"
    return {name: reason for name, reason in stale.items() if name in contents}


def text_of(path: Path) -> str:
    """Return the text of a file that a user wrote."""
    try:
        return content_of(path).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LabFileError(
            f"{path}: {error}",
            needed="text in UTF-8",
            remedy="Save the file as plain text in UTF-8.",
        ) from error
