"""The benchmark of the zoo has reproducible stages and counts its detections."""

import json

import pytest

from benchmarks.zoo.__main__ import read
from benchmarks.zoo.score import Case, ScoredFinding, case_of_row
from benchmarks.zoo.stages import HIDDEN, KINDS, NAMES, stage, stage_requests
from benchmarks.zoo.table import confusion, share, table
from piezoid_datasets.virtual_lab.truths import ZOO


def finding(name: str, *, truth: float | None = None, p_value: float = 1e-9) -> ScoredFinding:
    return ScoredFinding(
        name=name,
        p_value=p_value,
        rms_percent=0.1,
        value=5.0,
        unit="us",
        ci95=(4.0, 6.0),
        truth=truth,
    )


def case(
    kind: str, hidden: tuple[str, ...], *findings: ScoredFinding, past_percent: float | None = None
) -> Case:
    return Case(
        law="dahl",
        kind=kind,
        size=1.0,
        seed=len(hidden),
        hidden=hidden,
        findings=findings,
        unexplained=0.5,
        past_percent=past_percent,
        noise_percent=0.05,
        times_noise=1.2,
    )


def test_a_stage_does_not_depend_on_the_other_stages():
    subset = list(stage_requests(["dahl"], ["single", "pair"], 2, 5))
    full_set = list(stage_requests([law.name for law in ZOO], list(KINDS), 3, 5))
    assert all(task in full_set for task in subset)
    assert len({task.seed for task in full_set}) == len(full_set) == 3 * len(KINDS) * len(ZOO)
    assert tuple(law.name for law in ZOO) == NAMES


def test_every_effect_occurs_at_the_size_of_its_kind():
    hidden = {name for k in range(len(HIDDEN)) for name in stage("lugre", "single", k, 0).hidden}
    assert hidden == set(HIDDEN)
    full_size, quarter = (stage("lugre", kind, 3, 0).hidden for kind in ("single", "quarter"))
    assert {name: size / 4.0 for name, size in full_size.items()} == pytest.approx(dict(quarter))
    assert [len(stage("dahl", kind, 1, 0).hidden) for kind in ("healthy", "pair", "triple")] == [
        *(0, 2, 3)
    ]


def test_the_table_counts_detections_false_alarms_and_intervals():
    cases = [
        case("single", ("delay",), finding("delay", truth=5.5), finding("lag")),
        case("single", ("lag",), finding("lag", truth=7.0), finding("something_else")),
        case("pair", ("creep", "delay"), finding("creep")),
        case("healthy", (), finding("lag", p_value=0.01)),
        case("healthy", (), finding("initial_state"), past_percent=0.2),
        case("healthy", (), finding("initial_state"), past_percent=0.01),
        *[case("healthy", (), past_percent=0.2)] * 3,
    ]
    text = table(cases, list(KINDS))
    row = next(line for line in text.splitlines() if line.startswith("| dahl"))
    cells = [cell.strip() for cell in row.strip("| ").split("|")]
    assert [cell.split(" ")[0] for cell in cells] == [
        *("dahl", "3/4", "3/4", "1/3", "3/6", "1", "1/2", "1.2")
    ]
    assert "p <= 0.05 in 3/6" in text
    assert "p <= 1e-06 in 2/6" in text
    matrix = confusion(cases)
    assert "delay: named 1, said lag 1, missed 1" in matrix
    assert "healthy: said lag 1, said initial_state 1" in matrix


def test_a_share_has_the_interval_of_clopper_and_pearson():
    assert share(0, 0) == "-"
    assert share(0, 20) == f"0/20 (0-{100 * (1 - 0.025 ** (1 / 20)):.0f} %)"
    assert share(20, 20) == f"20/20 ({100 * 0.025 ** (1 / 20):.0f}-100 %)"


def test_an_interrupted_run_continues(tmp_path):
    path = tmp_path / "zoo.jsonl"
    rows = [case("single", ("delay",), finding("delay", truth=5.5)), case("healthy", ())]
    lines = [json.dumps(row_case.row()) for row_case in rows]
    path.write_text(lines[0] + "\n" + lines[1] + "\n" + lines[0][:40])
    cases = read(path)
    assert list(cases.values()) == rows
    assert path.read_text() == lines[0] + "\n" + lines[1] + "\n"
    assert case_of_row(json.loads(lines[0])) == rows[0]
    assert read(tmp_path / "none.jsonl") == {}
