"""The ``shell`` directive: commands that run while the page is built, and what they print.

All blocks of a page share one empty folder, in which ``datasets`` leads to the bundled recordings.
A command that ends with another status than ``:status:`` (0) stops the build.
"""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import ClassVar

from docutils import nodes
from docutils.parsers.rst import directives
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util.docutils import SphinxDirective

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = "84"  # that a page shows without scrolling


class Shell(SphinxDirective):
    """Run a block of shell lines and show them with their output."""

    has_content = True
    option_spec: ClassVar = {
        "status": directives.nonnegative_int,
        "lines": directives.positive_int,  # of the output; the rest is left out, and said to be
    }

    def run(self) -> list[nodes.Node]:
        """Return the commands as one block and their output as another."""
        script = "\n".join(self.content)
        done = subprocess.run(
            ["bash", "-e", "-o", "pipefail", "-c", script],
            cwd=self._folder(),
            env=_environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        expected = self.options.get("status", 0)
        if done.returncode != expected:
            raise ExtensionError(
                f"{self.env.docname}, line {self.lineno}: status {done.returncode}, but "
                f"{expected} is needed.\n{script}\n{done.stdout}"
            )
        typed = nodes.literal_block(script, script, language="bash")
        printed = _cut(done.stdout, self.options.get("lines"))
        if not printed:
            return [typed]
        answer = nodes.literal_block(printed, printed, language="text", classes=["printed"])
        return [typed, answer]

    def _folder(self) -> Path:
        folder = Path(self.env.app.doctreedir).parent / "shell" / self.env.docname
        if "shell" not in self.env.temp_data:
            self.env.temp_data["shell"] = True
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            (folder / "datasets").symlink_to(ROOT / "datasets")
        return folder


def _environment() -> dict[str, str]:
    return {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "COLUMNS": COLUMNS,
        "TERM": "dumb",
        "NO_COLOR": "1",
    }


def _cut(text: str, count: int | None) -> str:
    lines = [line.rstrip() for line in re.sub(r"\x1b\[[0-9;]*m", "", text).splitlines()]
    if count and len(lines) > count:
        lines = [*lines[:count], f"[{len(lines) - count} more lines]"]
    return "\n".join(lines).strip("\n")


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("shell", Shell)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
