"""Displacements that turn before their drive: smoothed readings and delayed drives."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.numerics.arrays import Array
from tests.laws import LAWS, recorded, triangles

FIELD = triangles(8, 600)


def quantities_of(folder: Path, reading_um: Array, field: Array = FIELD) -> list[str]:
    return [p.quantity for p in recorded(folder, field, reading_um).statements]


def reading(law: str, noise_um: float = 0.02, field: Array = FIELD) -> Array:
    noise = noise_um * np.random.default_rng(5).standard_normal(len(field))
    return np.asarray(6.0 + 10.0 * LAWS[law](field) + noise)


def moving_average(values: Array, width: int) -> Array:
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


@pytest.mark.parametrize("law", LAWS)
def test_a_centred_average_is_reported(tmp_path, law):
    assert "smoothed" not in quantities_of(tmp_path, reading(law))
    recording = recorded(tmp_path, FIELD, moving_average(reading(law), 51))
    (statement,) = (p for p in recording.statements if p.quantity == "smoothed")
    samples = int(statement.text.partition("(")[2].partition(" ")[0])
    assert 17 <= samples <= 32  # half the window: 25


@pytest.mark.parametrize("law", ["preisach", "dahl", "duhem"])
def test_a_lag_ringing_or_clipping_is_no_smoothing(tmp_path, law):
    lagging = lfilter([0.1], [1.0, -0.9], reading(law) - 6.0)
    pole = 0.99 * np.exp(2j * np.pi / 40)
    ringing = lfilter(
        [abs(1 - pole) ** 2], [1.0, -2 * pole.real, abs(pole) ** 2], reading(law, 0.0)
    )
    noise = 0.02 * np.random.default_rng(6).standard_normal(len(FIELD))
    clipped = np.clip(reading(law, 0.0), -2.0, 13.0) + noise
    for values in (lagging, ringing + noise, clipped):
        assert not {"smoothed", "leads"} & set(quantities_of(tmp_path, values))


def test_a_delayed_drive_is_reported_with_its_delay(tmp_path):
    delayed = np.concatenate([np.full(20, FIELD[0]), FIELD[:-20]])
    recording = recorded(tmp_path, delayed, reading("preisach"))
    leads = [s for s in recording.statements if s.quantity == "leads" and s.unit == "s"]
    assert [round(500.0 * s.value) for s in leads if s.value] == [pytest.approx(20, abs=4)]


def test_a_smoothed_sine_is_not_reported(tmp_path):
    sine = -np.cos(2.0 * np.pi * np.arange(4800) / 600.0)
    smooth = moving_average(reading("preisach", field=sine), 51)
    assert "smoothed" not in quantities_of(tmp_path, smooth, sine)


@pytest.mark.parametrize("law", LAWS)
def test_a_staircase_is_neither_smoothed_nor_leading(tmp_path, law):
    # Its turns are flat, so half of a turn seems to precede the last step.
    levels = np.tile(np.concatenate([np.arange(-5, 5), np.arange(5, -5, -1)]), 6) / 5.0
    for samples in (50, 200):
        stairs = np.repeat(levels, samples)
        quantities = set(quantities_of(tmp_path, reading(law, field=stairs), stairs))
        assert not {"smoothed", "leads"} & quantities
