"""Objects that a user may have in any folder."""

import os
import stat
from pathlib import Path

KINDS = (
    *("file", "private file", "folder", "empty folder", "link", "link to folder"),
    *("broken link", "pipe", "device"),
)


def plant(kind: str, path: Path, beyond: Path) -> None:
    """Create an object of a kind; links lead to a file and a folder below ``beyond``."""
    (beyond / "folder").mkdir(parents=True, exist_ok=True)
    (beyond / "file").write_text("beyond")
    (beyond / "folder/a.h").write_text("beyond")
    path.parent.mkdir(parents=True, exist_ok=True)
    if kind == "folder":
        (path / "deep").mkdir(parents=True)
        (path / "deep/file").write_text("mine")
        path.chmod(0o700)
    elif kind == "empty folder":
        path.mkdir(0o711)
    elif "link" in kind:
        name = {"link": "file", "link to folder": "folder"}.get(kind, "nowhere")
        path.symlink_to(beyond / name)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "device" and os.geteuid() == 0:
        os.mknod(path, stat.S_IFCHR | 0o600, os.makedev(1, 3))
    else:
        path.write_text("mine")
        path.chmod(0o400 if kind == "private file" else 0o644)


def look(path: Path) -> dict[str, tuple[object, ...]]:
    """Return type, mode, inode, link and content of everything at and below a path."""
    if not os.path.lexists(path):
        return {}
    status = path.lstat()
    content: object = os.readlink(path) if stat.S_ISLNK(status.st_mode) else None
    content = path.read_bytes() if stat.S_ISREG(status.st_mode) else content
    description: dict[str, tuple[object, ...]] = {
        str(path): (status.st_mode, status.st_ino, status.st_rdev, content)
    }
    if stat.S_ISDIR(status.st_mode):
        for entry in sorted(path.iterdir()):
            description |= look(entry)
    return description
