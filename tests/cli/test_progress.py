"""Progress of a verb in a log: few lines, each new, with the elapsed time."""

import time

from piezoid_cli.terminal import VERBOSE, Log, REPEAT_s, show_progress


def test_a_log_has_at_most_a_line_per_period():
    lines: list[str] = []
    with Log(lines.append).at_intervals(0.05) as report:
        for k in range(12):
            report(f"stage {k}")
            time.sleep(0.02)
    assert 2 <= len(lines) <= 6
    assert len(set(lines)) == len(lines)
    time.sleep(0.12)
    assert len(lines) <= 6  # nothing is written after the end


def test_short_work_writes_nothing(capsys):
    with show_progress(quiet=False) as report:
        report("reading")
    assert capsys.readouterr() == ("", "")


def test_a_long_step_is_not_repeated_within_30_seconds():
    lines: list[str] = []
    with Log(lines.append).at_intervals(0.02) as report:
        report("refitting")
        time.sleep(0.15)
    assert [line.split("  ")[-1] for line in lines] == ["refitting"]
    assert REPEAT_s > 30.0


def test_verbose_logs_every_step_and_quiet_none(capsys):
    token = VERBOSE.set(True)
    try:
        with show_progress(quiet=False) as report:
            for stage in ("reading", "fitting", "fitting", "writing \x1b[2J"):
                report(stage)
        with show_progress(quiet=True) as report:
            report("silence")
    finally:
        VERBOSE.reset(token)
    output = capsys.readouterr()
    assert output.out == ""
    assert [line.split("s  ")[1] for line in output.err.splitlines()] == [
        "reading",
        "fitting",
        r"writing \x1b[2J",
    ]


def test_a_verb_sets_the_time_to_its_first_line(capfd):
    with show_progress(quiet=False, interval_s=0.05) as report:
        report("reading big.csv")
        time.sleep(0.4)
    assert "reading big.csv" in capfd.readouterr().err
    with show_progress(quiet=False, interval_s=5.0) as report:
        report("reading small.csv")
    assert capfd.readouterr().err == ""
