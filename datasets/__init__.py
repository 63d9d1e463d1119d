"""Bundled recordings with their manifest, and the laboratory that made them."""

from importlib.resources import files
from pathlib import Path

FOLDER = Path(str(files(__name__)))
MANIFEST = FOLDER / "manifest.toml"
LAB = FOLDER / "lab.toml"


def recordings() -> tuple[Path, ...]:
    """Return the bundled recordings, in the order of the manifest."""
    import tomllib

    manifest = tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
    return tuple(FOLDER / entry["file"] for entry in manifest["recording"])
