"""The files of one stage belong together; where they do not, somebody has to be told."""

from json import loads
from pathlib import Path
from typing import TYPE_CHECKING

from piezoid.errors import LabFileError, ParameterFileError

if TYPE_CHECKING:
    from piezoid.records.lab import Lab

LAB = "lab.toml"


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


def text_of(place: Path) -> str:
    """Read a text file that somebody wrote by hand."""
    content = place.read_bytes()
    try:
        return content.decode("utf-8-sig")
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
