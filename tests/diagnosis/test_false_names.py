"""What looks like a fault of the data or like motion in time, and is neither."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from piezoid import diagnose, read
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.records.invalid_samples import find_invalid_readings
from tests.diagnosis.ceramic import bouc_wen_um
from tests.records.responses import write_csv

HOLD, RAMP = 40, 6  # samples
LEVELS = 120


def held_levels() -> tuple[np.ndarray, np.ndarray]:
    """Return drive and reading of levels that are held, the reading rounded to 1 nm."""
    rng = np.random.default_rng(11)
    levels_V = np.concatenate([[0.0, 100.0, 0.0], rng.uniform(0.0, 100.0, LEVELS)])
    pieces = [np.full(HOLD, levels_V[0])]
    for before_V, after_V in itertools.pairwise(levels_V):
        ramp_V = np.linspace(before_V, after_V, RAMP + 1)[1:]
        pieces += [ramp_V, np.full(HOLD, after_V)]
    drive_V = np.concatenate(pieces)
    reading_um = bouc_wen_um(drive_V) + rng.normal(0.0, 2e-3, len(drive_V))
    return drive_V, np.round(reading_um, 3)


@pytest.fixture(scope="module")
def levels(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    drive_V, reading_um = held_levels()
    place: Path = tmp_path_factory.mktemp("levels") / "levels.csv"
    time_s = np.arange(len(drive_V)) / 5000.0
    write_csv(place, "time [s],voltage [V],displacement [um]", time_s, drive_V, reading_um)
    return diagnose(read(place))


def test_equal_readings_at_the_end_of_a_hold_are_measurements() -> None:
    drive_V, reading_um = held_levels()
    assert find_invalid_readings(reading_um, drive_V) == ()


def test_levels_that_are_held_have_no_outliers(levels: Diagnosis) -> None:
    assert "outliers" not in levels.names
    assert "loop_shape" in levels.names
    assert not any("single readings" in remark for remark in levels.model.verdict.remarks)
