"""Contract of the checks: same signature, no report about clean recordings, registration."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from piezoid.records import checks
from piezoid.records.collection import collect
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from tests.laws import LAWS, recorded, triangles

SET_CHECKS = (*checks.SET_CHECKS, *checks.SET_CHECKS_OF_CONSISTENT)
NOISE_um = 0.008
SWEEP, LOOPS = triangles(6, 300, 0.04), 0.5 * triangles(8, 200, 0.04)


def clean(folder: Path, law: str, drive: np.ndarray, seed: int) -> Recording:
    noise_um = NOISE_um * np.random.default_rng(seed).standard_normal(len(drive))
    folder.mkdir()
    return recorded(folder, drive, 10.0 * LAWS[law](drive) + noise_um)


@pytest.mark.parametrize("law", sorted(LAWS))
def test_every_check_is_silent_over_clean_recordings(tmp_path, law):
    recordings = [clean(tmp_path / "a", law, SWEEP, 1), clean(tmp_path / "b", law, LOOPS, 2)]
    for recording in recordings:
        for check in checks.CHECKS:
            assert check(recording, Lab()) == [], check.__name__
        for check in checks.AXIS_CHECKS:
            assert check(recording, recording.axis) == [], check.__name__
    assert {c.__name__: c(recordings) for c in SET_CHECKS} == {c.__name__: [] for c in SET_CHECKS}


def test_every_check_of_the_folder_is_registered_under_one_signature():
    folder = Path(checks.__file__).parent
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__", "columns"}
    of_one = (*checks.CHECKS, *checks.AXIS_CHECKS)
    registered = (*of_one, *SET_CHECKS)
    assert {check.__module__.rpartition(".")[2] for check in registered} == modules
    for check in registered:
        assert check.__name__.startswith("check_")
        count = 2 if check in of_one else 1
        assert len(inspect.signature(check).parameters) == count


def test_a_recording_without_displacement_is_reported_once(tmp_path):
    rows = "\n".join(f"{k / 1000},{k % 7}" for k in range(200))
    (tmp_path / "a.csv").write_text(f"time [s],voltage [V]\n{rows}\n")
    statements = collect([tmp_path / "a.csv"])[0].statements
    assert [s.quantity for s in statements] == ["incomplete"]
