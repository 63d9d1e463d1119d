"""The help teaches: every verb shows how it is typed, and what is typed there is understood."""

import os
import re
import shlex
import subprocess
import sys

import click
import pytest
import typer
from typer.testing import CliRunner

from piezoid_cli.main import VERBS, app

COMMAND = typer.main.get_command(app)


def examples(verb: str) -> list[str]:
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, [verb, "--help"]).output
    _, _, taught = shown.partition("Example")
    return re.findall(rf"piezoid {verb} [^\n]*", taught.partition("─")[0])


@pytest.mark.parametrize("verb", [verb.__name__ for verb in VERBS])
def test_every_example_of_a_verb_is_one_it_accepts(verb: str) -> None:
    assert isinstance(COMMAND, click.Group | typer.core.TyperGroup)
    lines = examples(verb)
    assert lines
    command = COMMAND.commands[verb]
    for line in lines:
        words = shlex.split(re.split(r"[|>&]", line)[0])[2:]
        # Parsing refuses an option that is not there; nothing is run.
        command.make_context(verb, words)


def test_every_verb_says_in_one_line_what_it_is_for() -> None:
    for verb in VERBS:
        first = (verb.__doc__ or "").partition("\n")[0]
        assert first.endswith(".")
        assert len(first) < 99


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_shells_can_complete_the_verbs(shell: str) -> None:
    asked = {
        "_PIEZOID_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "piezoid d",
        "COMP_WORDS": "piezoid d",
        "COMP_CWORD": "1",
    }
    found = CliRunner().invoke(app, [], env=asked, prog_name="piezoid")
    assert "diagnose" in found.output
    assert "design" in found.output
    assert "verify" not in found.output


def test_no_number_of_threads_from_outside_is_kept() -> None:
    code = "import os, piezoid_cli.main; print(os.environ['OPENBLAS_NUM_THREADS'])"
    outside = os.environ | {"OPENBLAS_NUM_THREADS": "4"}
    done = subprocess.run(
        [sys.executable, "-c", code], env=outside, capture_output=True, text=True, check=True
    )
    assert done.stdout == "1\n"


def test_a_verb_that_is_not_there_is_answered_with_those_that_are() -> None:
    shown = CliRunner(env={"COLUMNS": "300"}).invoke(app, ["fitt"])
    assert shown.exit_code == 2
    assert "there is no command 'fitt'. Needed: one of inspect, init, fit" in shown.output
    assert "Did you mean fit?" in shown.output
    unlike = CliRunner(env={"COLUMNS": "300"}).invoke(app, ["qqq"])
    assert "See piezoid --help." in unlike.output


def test_no_table_of_lab_toml_is_lost_to_the_markup_and_every_status_is_named() -> None:
    shown = CliRunner(env={"COLUMNS": "200"}).invoke(app, ["verify", "--help"]).output
    assert "default: [verification] of lab.toml" in shown
    overall = " ".join(CliRunner().invoke(app, ["--help"]).output.split())
    for status in ("0 success", "1 a verdict", "2 wr", "3 unus", "4 no", "70 internal", "130 int"):
        assert status in overall
