"""Docstrings as this project writes them: prose, and equations and tables set in columns."""

import re
from typing import Any

from sphinx.application import Sphinx

_COLUMNS = re.compile(r"\S {2,}\S")
_CODE = re.compile(r"(``.+?``)")
_MARKS = re.compile(r"([*|\\]|(?<=\w)_(?!\w)|`)")


def _as_text(_: Sphinx, __: str, ___: str, ____: Any, _____: Any, lines: list[str]) -> None:
    """Keep examples and columns as they are, and escape what RST would read into prose."""
    text = "\n".join(lines).strip("\n")
    found: list[str] = []
    for block in re.split(r"\n\s*\n", text):
        rows = block.splitlines()
        if rows[0].startswith(">>> "):
            found += [".. code-block:: pycon", "", *(f"    {row}" for row in rows), ""]
        elif any(row.startswith(" ") or _COLUMNS.search(row) for row in rows):
            found += [".. code-block:: none", "", *(f"    {row}" for row in rows), ""]
        else:
            found += [*(_escaped(row) for row in rows), ""]
    lines[:] = found


def _escaped(row: str) -> str:
    parts = _CODE.split(row)
    return "".join(p if k % 2 else _MARKS.sub(r"\\\1", p) for k, p in enumerate(parts))


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the hook."""
    app.connect("autodoc-process-docstring", _as_text)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
