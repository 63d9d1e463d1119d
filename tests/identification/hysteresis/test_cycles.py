"""What goes on slowly over many equal cycles is found cycle by cycle, far below the noise."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.hysteresis.cycles import trends_over_cycles
from piezoid.identification.hysteresis.pieces import Piece, Rig, pieces_of, scales_of
from piezoid.numerics.arrays import Array
from tests.laws import LAWS, recorded, triangles

COUNT, PERIOD, NOISE_um = 60, 80, 0.02
CYCLE = np.arange(COUNT * PERIOD) // PERIOD


def said(folder: Path, law: str, change: Array, added_um: Array) -> str:
    field = triangles(COUNT, PERIOD)
    noise_um = NOISE_um * np.random.default_rng(8).standard_normal(len(field))
    recording = recorded(folder, field, 10.0 * LAWS[law](field) * change + added_um + noise_um)
    scales = scales_of((recording,), "x")
    piece: Piece
    (piece,) = pieces_of((recording,), "x", scales, Rig())
    stroke_m = abs(scales.displacement_m)
    return " ".join(trends_over_cycles(piece, stroke_m, 1e-6 * NOISE_um / stroke_m))


@pytest.mark.parametrize("law", LAWS)
def test_a_sensitivity_that_falls_slowly_is_told_with_its_size(tmp_path: Path, law: str) -> None:
    text = said(tmp_path, law, 1.0 - 0.013 * CYCLE / (COUNT - 1), np.zeros(len(CYCLE)))
    assert "the sensitivity goes by -1.3" in text


def test_tips_that_wander_are_told_beside_the_noise(tmp_path: Path) -> None:
    level = 0.1 * np.random.default_rng(9).standard_normal(COUNT)
    text = said(tmp_path, "dahl", np.ones(len(CYCLE)), level[CYCLE])
    assert "the upper tip wanders by" in text
    assert "the sensitivity" not in text


@pytest.mark.parametrize("law", ["preisach", "duhem"])
def test_steady_cycles_have_no_trend(tmp_path: Path, law: str) -> None:
    assert said(tmp_path, law, np.ones(len(CYCLE)), np.zeros(len(CYCLE))) == ""
