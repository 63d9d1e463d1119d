"""Pages that an extension makes: a page that is the same is not written, and builds stay short."""

from collections.abc import Mapping
from pathlib import Path

from sphinx.application import Sphinx


def write(app: Sphinx, folder: str, pages: Mapping[str, bytes]) -> None:
    """Make a folder of the sources hold these files and no others."""
    held = Path(app.srcdir) / folder
    held.mkdir(exist_ok=True)
    for name, content in pages.items():
        place = held / name
        if not place.exists() or place.read_bytes() != content:  # else the page counts as changed
            place.write_bytes(content)
    for place in held.iterdir():
        if place.name not in pages:
            place.unlink()
