"""Help of every verb: examples that it accepts, a summary, exit codes."""

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
from tests.cli.calls import invoke

COMMAND = typer.main.get_command(app)


def examples(verb: str) -> list[str]:
    _, _, text = invoke(verb, "--help").output.partition("Example")
    return re.findall(rf"piezoid {verb} [^\n]*", text.partition("─")[0])


@pytest.mark.parametrize("verb", [verb.__name__ for verb in VERBS])
def test_every_verb_accepts_its_examples(verb):
    assert isinstance(COMMAND, click.Group | typer.core.TyperGroup)
    lines = examples(verb)
    assert lines
    command = COMMAND.commands[verb]
    for line in lines:
        words = shlex.split(re.split(r"[|>&]", line)[0])[2:]
        # Parsing refuses an unknown option and runs nothing.
        command.make_context(verb, words)


def test_every_verb_has_a_summary_of_a_line():
    for verb in VERBS:
        summary = (verb.__doc__ or "").partition("\n")[0]
        assert summary.endswith(".")
        assert len(summary) < 99


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_shells_can_complete_the_verbs(shell):
    environment = {
        "_PIEZOID_COMPLETE": f"complete_{shell}",
        "_TYPER_COMPLETE_ARGS": "piezoid d",
        "COMP_WORDS": "piezoid d",
        "COMP_CWORD": "1",
    }
    result = CliRunner().invoke(app, [], env=environment, prog_name="piezoid")
    assert "diagnose" in result.output
    assert "design" in result.output
    assert "verify" not in result.output


def test_linear_algebra_has_a_single_thread_in_any_environment():
    code = "import os, piezoid_cli.main; print(os.environ['OPENBLAS_NUM_THREADS'])"
    environment = os.environ | {"OPENBLAS_NUM_THREADS": "4"}
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert result.stdout == "1\n"


def test_an_unknown_verb_is_answered_with_the_known_verbs():
    result = invoke("fitt", columns=300)
    assert result.exit_code == 2
    assert "there is no command 'fitt'. Needed: one of inspect, init, fit" in result.output
    assert "Did you mean fit?" in result.output
    assert "See piezoid --help." in invoke("qqq").output


def test_the_help_shows_tables_of_lab_toml_and_every_exit_code():
    assert "default: [verification] of lab.toml" in invoke("verify", "--help").output
    summary = " ".join(invoke("--help").output.split())
    for status in ("0 success", "1 a verdict", "2 wr", "3 unus", "4 no", "70 internal", "130 int"):
        assert status in summary
