"""Bundled recordings with their manifest, and the simulator that produced them.

Imports nothing of the library, so that the library is tested against independent physics.
"""

from importlib.resources import files
from pathlib import Path

FOLDER = Path(str(files(__name__)))
MANIFEST = FOLDER / "manifest.toml"
LAB = FOLDER / "lab.toml"


def recordings() -> tuple[Path, ...]:
    """Return the bundled recordings over time, in the order of the manifest: X, Y, then Z."""
    return tuple(FOLDER / entry["file"] for entry in _manifest()["recording"])


def stage_files() -> tuple[Path, ...]:
    """Return all bundled files of the three-axis stage, the input of `make demo`."""
    spectroscopies = tuple(FOLDER / entry["file"] for entry in _manifest()["spectroscopy"])
    return recordings() + spectroscopies


def _manifest() -> dict[str, list[dict[str, str]]]:
    import tomllib

    return tomllib.loads(MANIFEST.read_text(encoding="utf-8"))
