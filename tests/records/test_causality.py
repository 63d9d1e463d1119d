"""Displacements that turn before their drive: readings smoothed afterwards, drives read late."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.numerics.arrays import Array
from tests.laws import LAWS, recorded, triangles

FIELD = triangles(8, 600)


def kinds(folder: Path, reading_um: Array, field: Array = FIELD) -> list[str]:
    return [p.quantity for p in recorded(folder, field, reading_um).statements]


def reading(law: str, noise_um: float = 0.02, field: Array = FIELD) -> Array:
    noise = noise_um * np.random.default_rng(5).standard_normal(len(field))
    return np.asarray(6.0 + 10.0 * LAWS[law](field) + noise)


def averaged(values: Array, width: int) -> Array:
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


@pytest.mark.parametrize("law", LAWS)
def test_a_centred_average_is_told_and_the_readings_as_recorded_are_not(
    tmp_path: Path, law: str
) -> None:
    assert "smoothed" not in kinds(tmp_path, reading(law))
    recording = recorded(tmp_path, FIELD, averaged(reading(law), 51))
    (told,) = (p for p in recording.statements if p.quantity == "smoothed")
    before = int(told.text.partition("(")[2].partition(" ")[0])
    assert 17 <= before <= 32  # half the window: 25


@pytest.mark.parametrize("law", ["preisach", "dahl", "duhem"])
def test_what_is_late_ringing_or_at_an_end_was_not_smoothed(tmp_path: Path, law: str) -> None:
    slow = lfilter([0.1], [1.0, -0.9], reading(law) - 6.0)
    pole = 0.99 * np.exp(2j * np.pi / 40)
    ring = lfilter([abs(1 - pole) ** 2], [1.0, -2 * pole.real, abs(pole) ** 2], reading(law, 0.0))
    noise = 0.02 * np.random.default_rng(6).standard_normal(len(FIELD))
    ends = np.clip(reading(law, 0.0), -2.0, 13.0) + noise
    for one in (slow, ring + noise, ends):
        assert not {"smoothed", "leads"} & set(kinds(tmp_path, one))


def test_a_drive_that_is_read_late_is_told_apart(tmp_path: Path) -> None:
    late = np.concatenate([np.full(20, FIELD[0]), FIELD[:-20]])
    recording = recorded(tmp_path, late, reading("preisach"))
    leads = [s for s in recording.statements if s.quantity == "leads" and s.unit == "s"]
    assert [round(500.0 * s.value) for s in leads if s.value] == [pytest.approx(20, abs=4)]


def test_of_a_sine_nothing_is_told(tmp_path: Path) -> None:
    sine = -np.cos(2.0 * np.pi * np.arange(4800) / 600.0)
    smooth = averaged(reading("preisach", field=sine), 51)
    assert "smoothed" not in kinds(tmp_path, smooth, sine)


@pytest.mark.parametrize("law", LAWS)
def test_of_a_staircase_nothing_is_told(tmp_path: Path, law: str) -> None:
    # its turns are flat: half of a turn seems made before the last step
    levels = np.tile(np.concatenate([np.arange(-5, 5), np.arange(5, -5, -1)]), 6) / 5.0
    for held in (50, 200):
        stairs = np.repeat(levels, held)
        told = set(kinds(tmp_path, reading(law, field=stairs), stairs))
        assert not {"smoothed", "leads"} & told
