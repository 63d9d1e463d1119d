"""The files of one stage belong together; where they do not, somebody has to be told."""

from json import loads

from piezoid.errors import ParameterFileError


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
