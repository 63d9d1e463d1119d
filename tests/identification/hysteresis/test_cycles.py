"""What goes on slowly over many equal cycles is found cycle by cycle, far below the noise."""

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


def cycles_in(folder: Path, field: Array, moved_um: Array) -> tuple[Cycles, str]:
    """Return the cycles of a recording, and what is said of their trends."""
    noise_um = NOISE_um * np.random.default_rng(8).standard_normal(len(field))
    piece, unit_m = piece_of(recorded(folder, field, moved_um + noise_um))
    cycles = cycles_of(piece)
    assert cycles is not None
    return cycles, " ".join(trends_over_cycles(cycles, abs(unit_m), 1e-6 * NOISE_um / abs(unit_m)))


def said(folder: Path, law: str, change: Array, added_um: Array) -> str:
    field = triangles(COUNT, PERIOD)
    return cycles_in(folder, field, 10.0 * LAWS[law](field) * change + added_um)[1]


@pytest.mark.parametrize("law", LAWS)
def test_a_sensitivity_that_falls_slowly_is_told_with_its_size(tmp_path, law):
    text = said(tmp_path, law, 1.0 - 0.013 * CYCLE / (COUNT - 1), np.zeros(len(CYCLE)))
    assert "the sensitivity changes by -1.3" in text


@pytest.mark.parametrize("shape", ["sine", "triangle"])
def test_a_period_of_no_whole_number_of_samples_hides_no_trend(tmp_path, shape):
    turn = np.arange(COUNT * PERIOD) / (PERIOD + 0.37)
    drive = np.cos(2.0 * np.pi * turn)
    if shape == "triangle":
        drive = 1.0 - 4.0 * np.abs((turn + 0.5) % 1.0 - 0.5)
    field = -drive  # from the lower tip
    for lost in (0.0, 0.013):
        change = 1.0 - lost * turn / turn[-1]
        _, text = cycles_in(tmp_path, field, 10.0 * LAWS["dahl"](field) * change)
        assert ("the sensitivity changes by -1." in text) == (lost > 0.0)


def test_tips_that_wander_are_told_beside_the_noise(tmp_path):
    level = 0.1 * np.random.default_rng(9).standard_normal(COUNT)
    slowly = np.interp(np.arange(len(CYCLE)) / PERIOD, np.arange(COUNT), level)
    text = said(tmp_path, "dahl", np.ones(len(CYCLE)), slowly)
    assert "the upper tip wanders by" in text
    assert "the sensitivity" not in text


@pytest.mark.parametrize("law", ["preisach", "duhem"])
def test_steady_cycles_have_no_trend(tmp_path, law):
    assert said(tmp_path, law, np.ones(len(CYCLE)), np.zeros(len(CYCLE))) == ""


@pytest.mark.parametrize("law", LAWS)
def test_a_displacement_of_another_clock_slides_against_its_drive(tmp_path, law):
    turn = np.arange(COUNT * PERIOD) / (PERIOD + 0.37)
    for ppm in (0.0, 700.0):
        moved_um = 10.0 * LAWS[law](-np.cos(2.0 * np.pi * turn * (1.0 - 1e-6 * ppm)))
        cycles, _ = cycles_in(tmp_path, -np.cos(2.0 * np.pi * turn), moved_um)
        said = [limit.reason for limit in limits_of_cycles([cycles])]
        assert len(said) == (1 if ppm else 0)
        assert not ppm or "+7" in said[0].partition("equal cycles (")[2][:3]
        assert not ppm or "falls behind its drive, by 6." in said[0]
