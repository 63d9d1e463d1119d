"""Names in the output of the terminal are text without control codes."""

import ast
import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

import piezoid_cli
from piezoid.diagnosis.diagnosis import HeldOut
from piezoid.identification.quality import IN_SAMPLE
from piezoid_cli.tables import budget_lines, table
from piezoid_cli.terminal import print_raw, rich_text, say, show_progress
from tests.cli.calls import invoke, run_module
from tests.reports.known_diagnosis import diagnosed
from tests.reports.known_stage import axis_model

CONTROL_CODES = "a\x1b[2J\x1b]0;title\x07\x9b31m\u202eb\x7f"
ESCAPED = r"a\x1b[2J\x1b]0;title\x07\x9b31m\u202eb\x7f"
FOLDER = Path(piezoid_cli.__file__).parent


def printed(*parts: object) -> str:
    stream = io.StringIO()
    Console(file=stream, force_terminal=True, color_system=None, width=200).print(*parts)
    return stream.getvalue()


def test_control_codes_are_escaped_and_brackets_kept(capsys):
    say(f"{CONTROL_CODES}[red]\n")
    say(CONTROL_CODES, err=True)
    output = capsys.readouterr()
    assert (output.out, output.err) == (rf"{ESCAPED}[red]\n" + "\n", f"{ESCAPED}\n")
    assert (
        printed(rich_text(f"{CONTROL_CODES}[red]\nsecond line"))
        == f"{ESCAPED}[red]\nsecond line\n"
    )


def test_raw_output_has_every_byte(capsysbinary):
    print_raw(b'{"name": "\xc2\x9b"}\n')
    print_raw('{"files": []}')
    assert capsysbinary.readouterr().out == b'{"name": "\xc2\x9b"}\n{"files": []}\n'


def test_a_progress_bar_takes_no_markup_from_a_name(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with show_progress(quiet=False) as progress:
        progress("reading [red]a.csv[/red]")
    assert "reading [red]a.csv[/red]" in capsys.readouterr().err


def test_only_the_terminal_module_prints():
    """`rich` draws tables and bars; a single module formats all their texts."""
    for path in FOLDER.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            source = ast.unparse(node) if isinstance(node, ast.Call | ast.ImportFrom) else ""
            if path.name != "terminal.py":
                assert not source.startswith(("typer.echo(", "print(")), path
                assert "TextColumn" not in source, path
                assert source != "from rich.text import Text" or path.name == "main.py", path


def test_inspect_and_init_escape_headings_and_file_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "a\x1b[2Jb\u202e.csv"
    rows = "\n".join(f"{k},{k % 7},{2 * (k % 7)}" for k in range(40))
    Path(name).write_text(f"time [s],volt{CONTROL_CODES}age [V],pos \x1b[31m [um]\n{rows}\n")
    for words in (
        ["inspect", name],
        ["init", name, "--out", "l\x1bab.toml"],
        ["inspect", "-\x1b"],
    ):
        output = invoke(*words).output
        assert r"\x1b" in output
        assert not set(output) & set("\x1b\x07\x9b\x7f\u202e")


@pytest.mark.parametrize("is_tested", [True, False])
def test_an_error_in_sample_is_not_called_held_out(is_tested):
    model = axis_model()
    if not is_tested:
        model = replace(model, quality=replace(model.quality, held_out_kind=IN_SAMPLE))
    line, *_ = budget_lines([replace(diagnosed(), model=model)])
    assert ("in sample" in line) is not is_tested


@pytest.mark.parametrize(("factor", "is_stated"), [(0.5, False), (10.0, True)])
def test_a_budget_states_a_final_error_above_that_of_the_base_model(factor, is_stated):
    diagnosis = diagnosed()
    final = HeldOut.of(factor * diagnosis.baseline.rms_m, 1e-5)
    line, *_ = budget_lines([replace(diagnosis, model=axis_model(), final=final)])
    assert ("larger error" in line) is is_stated


def test_no_cell_of_a_narrow_table_is_cut_off():
    output = io.StringIO()
    narrow = Console(file=output, width=16)
    narrow.print(table("t", ("method", "error"), [("guaranteed:", "281 nm")] * 2, n_words=1))
    assert "…" not in output.getvalue()


def test_errors_escape_the_codes_of_a_name(tmp_path):
    hostile = "x\x1b[2J"
    for words, status in (
        (["fit", hostile, "--out", "made"], 3),
        (["fit", hostile, "--out", "."], 2),
        (["--\x1b[2J"], 2),
    ):
        result = run_module(tmp_path, *words)
        assert result.returncode == status
        assert r"\x1b[2J" in result.stderr or "working directory" in result.stderr
        assert "\x1b[2J" not in result.stderr
