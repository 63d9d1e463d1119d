"""The examples of the README work, and its pages agree with the repository."""

import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path
from shutil import copyfile

import pytest
import typer
import yaml

import piezoid
from piezoid_cli.main import VERBS, app
from piezoid_cli.report import SEALED
from tests.journeys.readme_walk import WALKED, first_rows, lines_of

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    page
    for page in (*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md"))
    if page.parent.name != "effects"  # written when the documentation is built
)
LONGEST = 160  # lines of the README


def text_of(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


README = text_of("README.md")


def test_the_readme_is_short():
    assert len(README.splitlines()) <= LONGEST


def test_the_python_example_runs_on_the_recordings_of_the_shell_example(tmp_path):
    (example,) = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    for name in ("sweep", "check"):
        recording = ROOT / f"datasets/x_{name}.csv"
        (tmp_path / f"{name}.csv").write_text(first_rows(recording, rows=800))
    run = subprocess.run(
        [sys.executable, "-W", "error", "-c", example],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert re.search(r"held-out error 0\.[0-3]\d % of the range", run.stdout)


def test_the_readme_lists_every_file_that_a_stage_holds():
    table = README.partition("## What you get")[2].partition("\n## ")[0]
    for name in (*SEALED, "report.html", "lab.toml", "bundle/"):
        assert f"| `{name}` |" in table


@pytest.mark.parametrize("mark", ["", "ready", "by-make"])
def test_make_does_not_change_a_foreign_environment(mark, tmp_path):
    copyfile(ROOT / "Makefile", tmp_path / "Makefile")
    for name in ("pyproject.toml", "constraints.txt", f".venv/{mark}", ".venv/bin/python"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        if not name.endswith("/"):
            (tmp_path / name).touch()
    commands = subprocess.run(
        ["make", "--dry-run", "docs"], cwd=tmp_path, capture_output=True, text=True, check=True
    ).stdout
    assert (".venv/bin/python" in commands) == bool(mark)
    assert ("build/venv/bin/python" in commands) == (not mark)
    assert "minutes" in commands


def test_every_piezoid_command_of_the_pages_is_accepted():
    """``readme_walk.py`` runs them in the gate."""
    walked = [line for name in WALKED for line in lines_of(text_of(name))]
    commands = [line for line in walked if line.startswith("piezoid ")]
    assert {line.split()[1] for line in commands} == {verb.__name__ for verb in VERBS}
    command = typer.main.get_command(app)
    for line in commands:
        verb, *words = shlex.split(line, comments=True)[1:]
        command.commands[verb].make_context(verb, words)


def test_every_page_with_a_shell_block_is_walked():
    shells = {
        str(page.relative_to(ROOT)) for page in PAGES if "```sh\n" in page.read_text("utf-8")
    }
    assert shells == set(WALKED)


def test_the_map_names_every_folder_of_the_library():
    map_text = text_of("docs/map.md")
    folders = {path.parent.name for path in (ROOT / "piezoid").glob("*/__init__.py")}
    for folder in sorted(folders):
        assert f"`piezoid/{folder}/`" in map_text, folder


def test_every_cited_work_is_listed_in_the_sources():
    sources = set(re.findall(r"([A-Z]\w+) (\d{4})", text_of("docs/reference/sources.md")))
    for path in (*sorted((ROOT / "piezoid").rglob("*.py")), *PAGES):
        text = path.read_text(encoding="utf-8")
        cited = re.findall(r"\[([A-Z][^]\[]*\b(?:18|19|20)\d\d)[^]]{0,30}\](?!\()", text)
        if path.parent.name == "effects":
            cited += re.findall(r"([A-Z]\w+) \((\d{4})\)", text)
        for citation in cited:
            pairs = (
                [citation]
                if isinstance(citation, tuple)
                else re.findall(r"([A-Z]\w+) (\d{4})", citation)
            )
            assert set(pairs) <= sources, f"{path.name}: {citation}"


MADE_BY_DOCS = ("effects/", "laws/", "targets/")  # created and checked by the build of the pages


def test_files_named_by_pages_exist():
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for name in re.findall(r"`((?:benchmarks|tests|reports|piezoid|docs)/[\w/]+\.\w+)`", text):
            assert (ROOT / name).is_file(), f"{page}: {name}"
        for link in re.findall(r"\]\(([^)#:\s]+)\)", text):
            if not any(folder in link for folder in MADE_BY_DOCS):
                assert (page.parent / link).exists(), f"{page}: {link}"


def test_the_version_is_stated_once_and_cited():
    configuration = tomllib.loads(text_of("pyproject.toml"))
    assert "version" in configuration["project"]["dynamic"]
    assert yaml.safe_load(text_of("CITATION.cff"))["version"] == piezoid.__version__
    assert f"## {piezoid.__version__}" in text_of("CHANGELOG.md")


def test_every_schema_is_listed():
    listed = set(re.findall(r"`(piezoid\.\w+/\d+)`", text_of("SCHEMA_CHANGES.md")))
    paths = [
        path for folder in ("piezoid", "cli", "datasets") for path in (ROOT / folder).rglob("*.py")
    ]
    written = {
        schema
        for path in paths
        for schema in re.findall(r'"(piezoid\.\w+/\d+)"', path.read_text(encoding="utf-8"))
    }
    assert written <= listed
