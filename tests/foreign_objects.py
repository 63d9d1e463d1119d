"""Objects that a user may have in any folder: how to put one there, and what it is."""

import os
import stat
from pathlib import Path

KINDS = (
    *("file", "private file", "folder", "empty folder", "link", "link to folder"),
    *("broken link", "pipe", "device"),
)


def plant(kind: str, place: Path, beyond: Path) -> None:
    """Put an object of a kind at a place; links lead to a file and a folder below ``beyond``."""
    (beyond / "folder").mkdir(parents=True, exist_ok=True)
    (beyond / "file").write_text("beyond")
    (beyond / "folder/a.h").write_text("beyond")
    place.parent.mkdir(parents=True, exist_ok=True)
    if kind == "folder":
        (place / "deep").mkdir(parents=True)
        (place / "deep/file").write_text("mine")
        place.chmod(0o700)
    elif kind == "empty folder":
        place.mkdir(0o711)
    elif "link" in kind:
        name = {"link": "file", "link to folder": "folder"}.get(kind, "nowhere")
        place.symlink_to(beyond / name)
    elif kind == "pipe":
        os.mkfifo(place)
    elif kind == "device" and os.geteuid() == 0:
        os.mknod(place, stat.S_IFCHR | 0o600, os.makedev(1, 3))
    else:
        place.write_text("mine")
        place.chmod(0o400 if kind == "private file" else 0o644)


def look(place: Path) -> dict[str, tuple[object, ...]]:
    """Return what is at a place and below it: type, mode, inode, link and content."""
    if not os.path.lexists(place):
        return {}
    about = place.lstat()
    content: object = os.readlink(place) if stat.S_ISLNK(about.st_mode) else None
    content = place.read_bytes() if stat.S_ISREG(about.st_mode) else content
    seen: dict[str, tuple[object, ...]] = {
        str(place): (about.st_mode, about.st_ino, about.st_rdev, content)
    }
    if stat.S_ISDIR(about.st_mode):
        for entry in sorted(place.iterdir()):
            seen |= look(entry)
    return seen
