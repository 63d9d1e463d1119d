"""Plausibility of drive and response: causality, sense of rotation, limits of the amplifier."""

import numpy as np
import pytest
from scipy.signal import lfilter

from piezoid.numerics.arrays import Array
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import LAWS, recorded, triangles
from tests.records.tables import quantities_of, statements_of

FIELD = triangles(8, 600)


def reading(law: str, noise_um: float = 0.02, field: Array = FIELD) -> Array:
    noise = noise_um * np.random.default_rng(5).standard_normal(len(field))
    return np.asarray(6.0 + 10.0 * LAWS[law](field) + noise)


def moving_average(values: Array, width: int) -> Array:
    padded = np.pad(values, width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


@pytest.mark.parametrize("law", LAWS)
def test_a_centred_average_is_reported(tmp_path, law):
    assert "smoothed" not in quantities_of(recorded(tmp_path, FIELD, reading(law)))
    recording = recorded(tmp_path, FIELD, moving_average(reading(law), 51))
    (statement,) = statements_of(recording, "smoothed")
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
        recording = recorded(tmp_path, FIELD, values)
        assert not {"smoothed", "leads"} & quantities_of(recording)


def test_a_delayed_drive_is_reported_with_its_delay(tmp_path):
    delayed = np.concatenate([np.full(20, FIELD[0]), FIELD[:-20]])
    recording = recorded(tmp_path, delayed, reading("preisach"))
    leads = [s for s in statements_of(recording, "leads") if s.unit == "s"]
    assert [round(500.0 * s.value) for s in leads if s.value] == [pytest.approx(20, abs=4)]


def test_a_smoothed_sine_is_not_reported(tmp_path):
    sine = -np.cos(2.0 * np.pi * np.arange(4800) / 600.0)
    smooth = moving_average(reading("preisach", field=sine), 51)
    assert "smoothed" not in quantities_of(recorded(tmp_path, sine, smooth))


@pytest.mark.parametrize("law", LAWS)
def test_a_staircase_is_neither_smoothed_nor_leading(tmp_path, law):
    # Its turns are flat, so half of a turn seems to precede the last step.
    levels = np.tile(np.concatenate([np.arange(-5, 5), np.arange(5, -5, -1)]), 6) / 5.0
    for samples in (50, 200):
        stairs = np.repeat(levels, samples)
        recording = recorded(tmp_path, stairs, reading(law, field=stairs))
        assert not {"smoothed", "leads"} & quantities_of(recording)


@pytest.mark.parametrize("truth", ZOO, ids=[truth.name for truth in ZOO])
def test_exchanged_headings_are_reported_with_their_columns(truth, tmp_path):
    field = triangles(5, 240, 0.15)
    ceramic = truth.draw(np.random.default_rng(41))
    displacement_um = 20 * sum(ceramic.respond(field, np.array([1.0, -1.0])))
    displacement_um += 0.01 * np.random.default_rng(2).standard_normal(len(field))
    assert "leads" not in quantities_of(recorded(tmp_path, field, np.asarray(displacement_um)))
    exchanged = recorded(tmp_path, displacement_um / 5 - 2, 5 * field)
    (statement,) = statements_of(exchanged, "leads")
    assert 'columns = { voltage = "displacement [um]"' in statement.text


def test_exchanged_headings_of_a_random_drive_are_reported(tmp_path):
    """Its loops are small against the box of its range."""
    noise = np.random.default_rng(9).standard_normal(6000)
    smooth = np.convolve(noise, np.hanning(60), mode="valid")
    field = smooth / np.abs(smooth).max()
    displacement_um = 10.0 * LAWS["plays"](field)
    assert "leads" not in quantities_of(recorded(tmp_path, field, displacement_um))
    assert "leads" in quantities_of(recorded(tmp_path, displacement_um / 5.0, 5.0 * field))


@pytest.mark.parametrize("noise", [0.0, 0.02], ids=["", "with a noisy drive"])
def test_a_single_branch_has_no_sense_of_rotation(noise, tmp_path):
    field = np.linspace(-1.0, 1.0, 400) + noise * np.random.default_rng(3).standard_normal(400)
    for displacement in (field + 0.3 * field**2, field - 0.3 * field**2):
        assert "leads" not in quantities_of(recorded(tmp_path, field, displacement))


@pytest.mark.parametrize("law", LAWS)
def test_a_limit_of_the_amplifier_is_reported_in_volts(law, tmp_path):
    field = triangles(6, 300, 0.05)
    noise_um = 0.008 * np.random.default_rng(7).standard_normal(len(field))

    def stops_V(drive: np.ndarray) -> list[float | None]:
        recording = recorded(tmp_path, field, 10.0 * LAWS[law](drive) + noise_um)
        return [s.value for s in statements_of(recording, "stands")]

    assert stops_V(field) == []
    assert stops_V(np.minimum(field, 0.7)) == [pytest.approx(3.5, abs=0.15)]
    both_V = stops_V(np.clip(field, -0.7, 0.7))
    assert both_V == [pytest.approx(3.5, abs=0.15), pytest.approx(-3.5, abs=0.15)]


@pytest.mark.parametrize("law", LAWS)
def test_steps_and_rests_of_the_drive_are_no_limit(law, tmp_path):
    rng = np.random.default_rng(8)
    steps = np.repeat(rng.uniform(-1.0, 1.0, 60), 30)
    rests = np.concatenate(
        [np.r_[part, np.full(60, part[-1])] for part in np.split(triangles(6, 300), 12)]
    )
    for field in (steps, rests):
        noise_um = 0.008 * rng.standard_normal(len(field))
        recording = recorded(tmp_path, field, 10.0 * LAWS[law](field) + noise_um)
        assert "stands" not in quantities_of(recording)
