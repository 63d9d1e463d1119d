"""What people read of a file's names is text: nothing in it moves a cursor or turns a line."""

import ast
import io
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console
from typer.testing import CliRunner

import piezoid_cli
from piezoid_cli.main import app
from piezoid_cli.terminal import print_raw, rich_text, say, step_column

OBEYED = "a\x1b[2J\x1b]0;title\x07\x9b31m\u202eb\x7f"
TOLD = r"a\x1b[2J\x1b]0;title\x07\x9b31m\u202eb\x7f"
FOLDER = Path(piezoid_cli.__file__).parent


def printed(*parts: object) -> str:
    kept = io.StringIO()
    Console(file=kept, force_terminal=True, color_system=None, width=200).print(*parts)
    return kept.getvalue()


def test_a_name_is_shown_with_its_codes_and_its_brackets(
    capsys: pytest.CaptureFixture[str],
) -> None:
    say(f"{OBEYED}[red]\n")
    say(OBEYED, err=True)
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == (rf"{TOLD}[red]\n" + "\n", f"{TOLD}\n")
    assert printed(rich_text(f"{OBEYED}[red]\nsecond line")) == f"{TOLD}[red]\nsecond line\n"


def test_a_script_gets_every_byte(capsysbinary: pytest.CaptureFixture[bytes]) -> None:
    print_raw(b'{"name": "\xc2\x9b"}\n')
    print_raw('{"files": []}')
    assert capsysbinary.readouterr().out == b'{"name": "\xc2\x9b"}\n{"files": []}\n'


def test_a_progress_bar_takes_no_markup_from_a_name() -> None:
    task = type("Task", (), {"description": "reading [red]a.csv[/red]"})()
    assert step_column().render(task).plain == "reading [red]a.csv[/red]"


def test_no_verb_prints_past_the_terminal() -> None:
    """`rich` draws tables and bars; texts in them, and all lines, are made in one place."""
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            what = ast.unparse(node) if isinstance(node, ast.Call | ast.ImportFrom) else ""
            if path.name != "terminal.py":
                assert not what.startswith(("typer.echo(", "print(")), path
                assert "TextColumn" not in what, path
                assert what != "from rich.text import Text" or path.name == "main.py", path


def test_inspect_and_init_show_headings_and_file_names_as_text(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    name = "a\x1b[2Jb\u202e.csv"
    rows = "\n".join(f"{k},{k % 7},{2 * (k % 7)}" for k in range(40))
    Path(name).write_text(f"time [s],volt{OBEYED}age [V],pos \x1b[31m [um]\n{rows}\n")
    runner = CliRunner(env={"COLUMNS": "200"})
    for verb in (["inspect", name], ["init", name, "--out", "l\x1bab.toml"], ["inspect", "-\x1b"]):
        shown = runner.invoke(app, verb).output
        assert r"\x1b" in shown
        assert not set(shown) & set("\x1b\x07\x9b\x7f\u202e")


def test_what_went_wrong_is_told_without_the_codes_of_a_name(tmp_path: Path) -> None:
    hostile = "x\x1b[2J"
    for words, status in (
        (["design", hostile], 3),
        (["fit", hostile, "--out", "made"], 3),
        (["fit", hostile, "--out", "."], 2),
        (["--\x1b[2J"], 2),
    ):
        done = subprocess.run(
            [sys.executable, "-m", "piezoid_cli.main", *words],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == status
        assert r"\x1b[2J" in done.stderr or "working directory" in done.stderr
        assert "\x1b[2J" not in done.stderr
