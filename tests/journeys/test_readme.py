"""The README's examples are what they say, and its map names every floor."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import typer

from piezoid_cli.main import VERBS, app
from tests.journeys.readme_walk import lines_of

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_the_python_example_runs_from_the_checkout() -> None:
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", example],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert re.search(r"held-out error 0\.[0-3]\d % of the range", done.stdout)


def test_every_piezoid_line_is_one_it_accepts() -> None:
    """The gate runs them all, as printed: ``readme_walk.py``."""
    shown = [line for line in lines_of(README) if line.startswith("piezoid ")]
    assert {line.split()[1] for line in shown} == {verb.__name__ for verb in VERBS}
    command = typer.main.get_command(app)
    for line in shown:
        verb, *words = shlex.split(line, comments=True)[1:]
        command.commands[verb].make_context(verb, words)  # type: ignore[attr-defined]


def test_the_calls_of_the_runtime_are_those_of_its_header() -> None:
    (block,) = re.findall(r"```c\n(.*?)```", README, flags=re.DOTALL)
    header = (ROOT / "piezoid/runtime/piezoid_runtime.h").read_text(encoding="utf-8")
    example = (ROOT / "piezoid/runtime/example_main.c").read_text(encoding="utf-8")
    names = set(re.findall(r"\bpz_\w+", block))
    assert {"pz_state", "pz_start", "pz_step"} <= names
    for name in names:
        assert name in header
        assert name in example


def test_the_map_names_every_folder_of_the_library() -> None:
    folders = {path.parent.name for path in (ROOT / "piezoid").glob("*/__init__.py")}
    for folder in sorted(folders):
        assert f"`piezoid/{folder}/`" in README, folder


def test_every_work_that_a_docstring_cites_stands_among_the_sources() -> None:
    _, _, sources = README.partition("## Sources")
    known = set(re.findall(r"([A-Z]\w+) (\d{4})", sources))
    for place in sorted((ROOT / "piezoid").rglob("*.py")):
        text = place.read_text(encoding="utf-8")
        cited = re.findall(r"\[([A-Z][^]\[]*\b(?:18|19|20)\d\d)[^]]{0,30}\]", text)
        if place.parent.name == "effects":
            cited += re.findall(r"([A-Z]\w+) \((\d{4})\)", text)
        for one in cited:
            pairs = [one] if isinstance(one, tuple) else re.findall(r"([A-Z]\w+) (\d{4})", one)
            assert set(pairs) <= known, f"{place.name}: {one}"


def test_files_the_readme_names_exist() -> None:
    for name in re.findall(r"benchmarks/\w+\.py|reports/gallery/\w+\.svg", README):
        assert (ROOT / name).is_file(), name
