"""Slow trends over many equal cycles are detected far below the noise."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.cycles import (
    Cycles,
    cycles_of,
    limits_of_cycles,
    trends_over_cycles,
)
from piezoid.numerics.arrays import Array
from tests.identification.hysteresis.stages import piece_of
from tests.laws import LAWS, recorded, triangles

COUNT, PERIOD, NOISE_um = 60, 80, 0.02
CYCLE = np.arange(COUNT * PERIOD) // PERIOD


def cycles_in(folder: Path, field: Array, displacement_um: Array) -> tuple[Cycles, str]:
    """Return the cycles of a recording and the statements on their trends."""
    noise_um = NOISE_um * np.random.default_rng(8).standard_normal(len(field))
    piece, unit_m = piece_of(recorded(folder, field, displacement_um + noise_um))
    cycles = cycles_of(piece)
    assert cycles is not None
    return cycles, " ".join(trends_over_cycles(cycles, abs(unit_m), 1e-6 * NOISE_um / abs(unit_m)))


def trends_of(folder: Path, law: str, change: Array, added_um: Array) -> str:
    field = triangles(COUNT, PERIOD)
    return cycles_in(folder, field, 10.0 * LAWS[law](field) * change + added_um)[1]


@pytest.mark.parametrize("law", LAWS)
def test_a_slow_loss_of_sensitivity_is_stated_with_its_size(tmp_path, law):
    text = trends_of(tmp_path, law, 1.0 - 0.013 * CYCLE / (COUNT - 1), np.zeros(len(CYCLE)))
    assert "the sensitivity changes by -1.3" in text


@pytest.mark.parametrize("shape", ["sine", "triangle"])
def test_a_trend_is_detected_with_a_non_integer_period(tmp_path, shape):
    cycle = np.arange(COUNT * PERIOD) / (PERIOD + 0.37)
    drive = np.cos(2.0 * np.pi * cycle)
    if shape == "triangle":
        drive = 1.0 - 4.0 * np.abs((cycle + 0.5) % 1.0 - 0.5)
    field = -drive  # from the lower turning point
    for loss in (0.0, 0.013):
        change = 1.0 - loss * cycle / cycle[-1]
        _, text = cycles_in(tmp_path, field, 10.0 * LAWS["dahl"](field) * change)
        assert ("the sensitivity changes by -1." in text) == (loss > 0.0)


def test_drifting_tips_are_stated(tmp_path):
    level = 0.1 * np.random.default_rng(9).standard_normal(COUNT)
    drift_um = np.interp(np.arange(len(CYCLE)) / PERIOD, np.arange(COUNT), level)
    text = trends_of(tmp_path, "dahl", np.ones(len(CYCLE)), drift_um)
    assert "the upper tip wanders by" in text
    assert "the sensitivity" not in text


@pytest.mark.parametrize("law", ["preisach", "duhem"])
def test_steady_cycles_have_no_trend(tmp_path, law):
    assert trends_of(tmp_path, law, np.ones(len(CYCLE)), np.zeros(len(CYCLE))) == ""


@pytest.mark.parametrize("law", LAWS)
def test_a_displacement_of_another_clock_shifts_against_its_drive(tmp_path, law):
    cycle = np.arange(COUNT * PERIOD) / (PERIOD + 0.37)
    for ppm in (0.0, 700.0):
        displacement_um = 10.0 * LAWS[law](-np.cos(2.0 * np.pi * cycle * (1.0 - 1e-6 * ppm)))
        cycles, _ = cycles_in(tmp_path, -np.cos(2.0 * np.pi * cycle), displacement_um)
        reasons = [limit.reason for limit in limits_of_cycles([cycles])]
        assert len(reasons) == (1 if ppm else 0)
        assert not ppm or "+7" in reasons[0].partition("equal cycles (")[2][:3]
        assert not ppm or "falls behind its drive, by 6." in reasons[0]
