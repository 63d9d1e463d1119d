"""The files of one stage belong together; where they do not, somebody has to be told."""

from collections.abc import Mapping
from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

from piezoid.errors import LabFileError, ParameterFileError
from piezoid.output_folder import is_as_written

if TYPE_CHECKING:
    from piezoid.export.parameter_file import ParameterFile
    from piezoid.records.lab import Lab

LAB = "lab.toml"
WRITTEN_BY = {
    "model.json": "piezoid fit RECORDINGS --out {}",
    "diagnosis.json": "piezoid fit RECORDINGS --out {}",
    "design.json": "piezoid design {}",
    "params.json": "piezoid export {}",
    "verification.json": "piezoid verify {}",
}
_MOST_bytes = 1 << 27  # a hundred times what a stage of many recordings takes


def content_of(place: Path) -> bytes:
    """Return what a file of ours holds; ``OSError`` for a pipe or a device, which never ends."""
    from piezoid.records.readers.source import regular_size

    try:
        size = regular_size(place)
    except (FileNotFoundError, NotADirectoryError) as error:
        raise _missing(place) from error
    if size > _MOST_bytes:
        raise ParameterFileError(
            f"{place} has {size} bytes",
            needed=f"at most {_MOST_bytes}: it is none that piezoid wrote",
            remedy="Take the original, or write it again from the recordings.",
        )
    with place.open("rb") as stream:
        return stream.read(size)


def _missing(place: Path) -> ParameterFileError:
    """Say which is not there, the folder or the file in it, and which verb would write it."""
    folder = place.parent
    if place.name not in WRITTEN_BY:
        return ParameterFileError(
            f"there is no file {place}",
            needed="a file that can be read",
            remedy="Check its name.",
        )
    if not folder.is_dir():
        what = "is a file" if folder.exists() else "is not there"
        return ParameterFileError(
            f"{folder} {what}",
            needed="the folder of a stage, as `piezoid fit` writes it",
            remedy="Check its name, or make it: piezoid fit RECORDINGS --out FOLDER",
        )
    return ParameterFileError(
        f"{folder} holds no {place.name}",
        needed="the folder of a stage that has come so far",
        remedy=f"Run `{WRITTEN_BY[place.name].format(folder)}` first.",
    )


def same_model(model_content: bytes, digest: str, place: str, verb: str) -> None:
    """Refuse a file that was made from another model.json than the one beside it.

    digest  of the model, as ``place`` says
    verb    that writes ``place`` anew
    """
    found = str(loads(model_content).get("digest"))
    if found != digest:
        raise ParameterFileError(
            f"{place} was made from the model {digest[:19]}..., model.json is {found[:19]}...",
            needed="files of one and the same model",
            remedy=f"Run `{verb}` again, then everything that follows it.",
        )


def changed_in_bundle(stage: Path, file: "ParameterFile") -> tuple[str, ...]:
    """Return the files of bundle/ that are missing or not those of params.json."""
    from piezoid.export.bundle import bundle

    made = bundle(file).files
    places = {name: stage / "bundle" / name for name in made}
    return tuple(
        name
        for name, place in places.items()
        if not place.is_file() or content_of(place) != made[name]
    )


def out_of_date(stage: Path, contents: Mapping[str, bytes], lab: "Lab | None") -> dict[str, str]:
    """Return the sealed files that were made from others than those beside them, and why.

    contents  of the sealed files of a stage, by name
    lab       that holds for the stage now; None where there is none to compare with
    """
    from piezoid.export.parameter_file import from_json

    stale: dict[str, str] = {}
    digests = {name: str(loads(content).get("digest")) for name, content in contents.items()}
    if "diagnosis.json" in contents and not is_as_written(stage / "diagnosis.json"):
        stale["diagnosis.json"] = (
            f"not the one of this fit; run piezoid fit RECORDINGS --out {stage}"
        )
    if "params.json" in contents:
        file = from_json(contents["params.json"], str(stage / "params.json"))
        made_from = (("model.json", "model"), ("design.json", "design"))
        others = [
            name
            for name, key in made_from
            if name in digests and digests[name] != file.sources.get(key)
        ]
        if others:
            stale["params.json"] = f"exported from another {others[0]}; run piezoid export {stage}"
        elif changed := changed_in_bundle(stage, file):
            stale["verification.json"] = (
                f"bundle/{changed[0]} is missing or changed; run piezoid export {stage}"
            )
    if "design.json" in contents and lab is not None:
        rig = str(loads(contents["design.json"]).get("rig_digest"))
        if rig not in ("", lab.rig_digest):
            stale["verification.json"] = (
                f"the rig in {lab.place} was changed; run piezoid design {stage}, then "
                f"piezoid export {stage}"
            )
    if "verification.json" in contents:
        run = str(loads(contents["verification.json"]).get("parameters_digest"))
        shipped = digests.get("params.json", _digest_of_refused(stage))
        if "params.json" in stale or run != shipped:
            stale["verification.json"] = f"of another params.json; run piezoid export {stage}"
    return {name: why for name, why in stale.items() if name in contents}


def _digest_of_refused(stage: Path) -> str:
    place = stage / "refused" / "params.json"
    return str(loads(content_of(place)).get("digest")) if place.is_file() else ""


def text_of(place: Path) -> str:
    """Read a text file that somebody wrote by hand."""
    try:
        return content_of(place).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise LabFileError(
            f"{place}: {error}",
            needed="text in UTF-8",
            remedy="Save it again as plain text in UTF-8.",
        ) from error


def lab_of(stage: Path, given: Path | None) -> "Lab | None":
    """Read what the laboratory declares: the file that is named, or else the one of the stage."""
    from piezoid.records.lab import read_lab

    place = stage / LAB if given is None else given
    return read_lab(place) if given is not None or place.exists() else None
