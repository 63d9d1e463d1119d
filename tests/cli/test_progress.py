"""What a verb is doing shows in a log as well: few lines, each new, with the time it took."""

import time

import pytest

from piezoid_cli.progress import VERBOSE, Log, REPEAT_s, show_progress


def test_a_log_holds_one_line_a_period_and_the_stage_of_then() -> None:
    lines: list[str] = []
    with Log(lines.append).at_intervals(0.05) as told:
        for k in range(12):
            told(f"stage {k}")
            time.sleep(0.02)
    assert 2 <= len(lines) <= 6
    assert len(set(lines)) == len(lines)
    time.sleep(0.12)
    assert len(lines) <= 6  # nothing is written behind the end


def test_work_that_is_done_in_time_writes_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with show_progress(quiet=False) as told:
        told("reading")
    assert capsys.readouterr() == ("", "")


def test_a_stage_that_lasts_is_not_repeated_before_a_minute() -> None:
    lines: list[str] = []
    with Log(lines.append).at_intervals(0.02) as told:
        told("refitting")
        time.sleep(0.15)
    assert [line.split("  ")[-1] for line in lines] == ["refitting"]
    assert REPEAT_s > 30.0


def test_everything_is_told_as_it_begins_where_it_is_asked_for(
    capsys: pytest.CaptureFixture[str],
) -> None:
    token = VERBOSE.set(True)
    try:
        with show_progress(quiet=False) as told:
            for stage in ("reading", "fitting", "fitting", "writing \x1b[2J"):
                told(stage)
        with show_progress(quiet=True) as told:
            told("silence")
    finally:
        VERBOSE.reset(token)
    found = capsys.readouterr()
    assert found.out == ""
    assert [line.split("s  ")[1] for line in found.err.splitlines()] == [
        "reading",
        "fitting",
        r"writing \x1b[2J",
    ]


def test_the_time_to_the_first_line_is_chosen_by_the_verb(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with show_progress(quiet=False, interval_s=0.05) as report:
        report("reading big.csv")
        time.sleep(0.4)
    assert "reading big.csv" in capfd.readouterr().err
    with show_progress(quiet=False, interval_s=5.0) as report:
        report("reading small.csv")
    assert capfd.readouterr().err == ""
