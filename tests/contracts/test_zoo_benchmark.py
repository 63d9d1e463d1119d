"""The zoo's benchmark asks for the same stages however it is cut, and counts what it says."""

import json
from pathlib import Path

import pytest

from benchmarks.zoo.__main__ import read
from benchmarks.zoo.score import Case, Said, case_of_row
from benchmarks.zoo.stages import HIDDEN, KINDS, NAMES, asked_for, stage
from benchmarks.zoo.table import confusion, share, table
from piezoid_datasets.virtual_lab.truths import ZOO


def said(name: str, *, truth: float | None = None, p_value: float = 1e-9) -> Said:
    return Said(
        name=name,
        p_value=p_value,
        rms_percent=0.1,
        value=5.0,
        unit="us",
        ci95=(4.0, 6.0),
        truth=truth,
    )


def case(kind: str, hidden: tuple[str, ...], *found: Said, past: float | None = None) -> Case:
    return Case(
        law="dahl",
        kind=kind,
        size=1.0,
        seed=len(hidden),
        hidden=hidden,
        said=found,
        unexplained=0.5,
        past_percent=past,
        noise_percent=0.05,
        times_noise=1.2,
    )


def test_a_stage_is_the_same_whatever_else_is_asked_for() -> None:
    some = list(asked_for(["dahl"], ["single", "pair"], 2, 5))
    more = list(asked_for([law.name for law in ZOO], list(KINDS), 3, 5))
    assert all(one in more for one in some)
    assert len({one.seed for one in more}) == len(more) == 3 * len(KINDS) * len(ZOO)
    assert tuple(law.name for law in ZOO) == NAMES


def test_every_effect_comes_in_its_turn_at_the_size_of_its_kind() -> None:
    hidden = {name for k in range(len(HIDDEN)) for name in stage("lugre", "single", k, 0).hidden}
    assert hidden == set(HIDDEN)
    full, quarter = (stage("lugre", kind, 3, 0).hidden for kind in ("single", "quarter"))
    assert {name: size / 4.0 for name, size in full.items()} == pytest.approx(dict(quarter))
    assert [len(stage("dahl", kind, 1, 0).hidden) for kind in ("healthy", "pair", "triple")] == [
        *(0, 2, 3)
    ]


def test_the_table_counts_names_accusations_and_intervals() -> None:
    cases = [
        case("single", ("delay",), said("delay", truth=5.5), said("lag")),
        case("single", ("lag",), said("lag", truth=7.0), said("something_else")),
        case("pair", ("creep", "delay"), said("creep")),
        case("healthy", (), said("lag", p_value=0.01)),
        case("healthy", (), said("initial_state"), past=0.2),
        case("healthy", (), said("initial_state"), past=0.01),
        *[case("healthy", (), past=0.2)] * 3,
    ]
    text = table(cases, list(KINDS))
    row = next(line for line in text.splitlines() if line.startswith("| dahl"))
    cells = [cell.strip() for cell in row.strip("| ").split("|")]
    assert [cell.split(" ")[0] for cell in cells] == [
        *("dahl", "3/4", "3/4", "1/3", "3/6", "1", "1/2", "1.2")
    ]
    assert "p <= 0.05 in 3/6" in text
    assert "p <= 1e-06 in 2/6" in text
    blamed = confusion(cases)
    assert "delay: named 1, said lag 1, missed 1" in blamed
    assert "healthy: said lag 1, said initial_state 1" in blamed  # the other past is there


def test_a_share_has_the_interval_of_clopper_and_pearson() -> None:
    assert share(0, 0) == "-"
    assert share(0, 20) == f"0/20 (0-{100 * (1 - 0.025 ** (1 / 20)):.0f} %)"
    assert share(20, 20) == f"20/20 ({100 * 0.025 ** (1 / 20):.0f}-100 %)"


def test_a_run_that_was_cut_short_goes_on_where_it_was(tmp_path: Path) -> None:
    place = tmp_path / "zoo.jsonl"
    rows = [case("single", ("delay",), said("delay", truth=5.5)), case("healthy", ())]
    lines = [json.dumps(one.row()) for one in rows]
    place.write_text(lines[0] + "\n" + lines[1] + "\n" + lines[0][:40])
    held = read(place)
    assert list(held.values()) == rows
    assert place.read_text() == lines[0] + "\n" + lines[1] + "\n"
    assert case_of_row(json.loads(lines[0])) == rows[0]
    assert read(tmp_path / "none.jsonl") == {}
