"""What drive and response say of each other: a loop turns one way, whatever the law."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.records.ingest import ingest
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO
from piezoid_datasets.virtual_lab.truths.truth import Truth
from tests.laws import triangles, write


def kinds(recording: Recording) -> set[str]:
    return {problem.kind for problem in recording.problems}


@pytest.mark.parametrize("truth", ZOO, ids=[truth.name for truth in ZOO])
def test_exchanged_headings_turn_the_loop_round(truth: Truth, tmp_path: Path) -> None:
    field = triangles(5, 240, 0.15)
    ceramic = truth.draw(np.random.default_rng(41))
    moved_um = 20 * sum(ceramic.respond(field, np.array([1.0, -1.0])))
    moved_um += 0.01 * np.random.default_rng(2).standard_normal(len(field))
    right = write(tmp_path / "right.csv", field, np.asarray(moved_um))
    assert "leads" not in kinds(ingest(right))
    exchanged = write(tmp_path / "exchanged.csv", moved_um / 5 - 2, 5 * field)
    (said,) = [one.text for one in ingest(exchanged).problems if one.kind == "leads"]
    assert 'columns = { voltage = "displacement [um]"' in said


def test_one_branch_turns_no_way(tmp_path: Path) -> None:
    field = np.linspace(-1.0, 1.0, 400)
    for bent in (field + 0.3 * field**2, field - 0.3 * field**2):
        assert "leads" not in kinds(ingest(write(tmp_path / "one.csv", field, bent)))
