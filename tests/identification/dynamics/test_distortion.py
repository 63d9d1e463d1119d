"""Silent lines: what a square and a cube answer there in closed form, and what noise does."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.dynamics.distortion import detect_distortion, distortion_of
from piezoid.identification.dynamics.frequency_response import PeriodicData
from piezoid.numerics.arrays import Array
from piezoid.numerics.repetition import Repetition, find_repetition
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_reports.page import Page
from piezoid_reports.quantities import NARROW
from piezoid_reports.render import render
from tests.identification.dynamics.stage import PERIOD, record
from tests.reports.known_stage import axis_model, stage_model

A_V, B, C = 0.7, 3e-8, 5e-8
TONES = (5, 13, 37)
# Sums and differences of two tones with b A^2, doubles with half of it ...
SQUARE = {8: 1.0, 24: 1.0, 32: 1.0, 18: 1.0, 10: 0.5, 26: 0.5}
# ... and of three with c A^3 times 3/2, of two and the double of one 3/4, triples 1/4.
CUBE = {19: 1.5, 29: 1.5, 23: 0.75, 27: 0.75, 31: 0.75, 21: 0.75, 11: 0.75, 15: 0.25}


def tones(rng: np.random.Generator) -> Array:
    """One period of three odd lines of one amplitude, at random phases."""
    turn = 2.0 * np.pi * np.arange(512) / 512
    return np.asarray(sum(A_V * np.cos(k * turn + rng.uniform(0, 2 * np.pi)) for k in TONES))


def answered(u_V: Array, noise_m: Array) -> PeriodicData:
    """The answer of a static curve with a square and a cube, four periods."""
    moved_m = 1e-6 * u_V + B * u_V**2 + C * u_V**3
    return PeriodicData(
        sampling_rate_Hz=512.0,
        inputs=("x",),
        outputs=("x",),
        voltage_V=np.tile(u_V[:, None, None, None], 4),
        displacement_m=moved_m[:, None, None, None] + noise_m,
    )


def test_a_square_answers_at_even_lines_and_a_cube_at_odd_ones_as_calculated(
    rng: np.random.Generator,
) -> None:
    found = detect_distortion(answered(tones(rng), np.zeros((512, 1, 1, 4))))
    expected = np.zeros(38)
    for line, share in SQUARE.items():
        expected[line] = share * B * A_V**2
    for line, share in CUBE.items():
        expected[line] = share * C * A_V**3
    lines = np.round(found.frequency_Hz).astype(int)
    np.testing.assert_allclose(found.amplitude_m[:, 0], expected[lines], atol=1e-18)
    even = np.sqrt(np.mean(expected[6:37:2] ** 2))
    assert found.level_m(even=True)[0] == pytest.approx(even, rel=1e-6)
    odd_lines = np.setdiff1d(np.arange(5, 38, 2), TONES)
    odd = np.sqrt(np.mean(expected[odd_lines] ** 2))
    assert found.level_m(even=False)[0] == pytest.approx(odd, rel=1e-6)


def test_noise_is_told_from_distortion_and_has_the_level_it_was_given(
    rng: np.random.Generator,
) -> None:
    """A line's amplitude of white noise has mean square 4 s^2 / N, over periods once more."""
    quiet = record(rng, silent=4, noise_m=5e-9)
    found = detect_distortion(quiet)
    expected = 5e-9 * np.sqrt(4.0 / PERIOD / 4)
    assert found.noise_level_m()[0] == pytest.approx(expected, rel=0.1)
    bent = detect_distortion(record(rng, silent=4, noise_m=5e-9, cubic=0.05))
    assert bent.noise_level_m()[0] == pytest.approx(expected, rel=0.1)
    assert bent.level_m(even=False)[0] > 20 * bent.limit_m(even=False)[0]
    assert bent.level_m(even=True)[0] < 2 * bent.limit_m(even=True)[0]


def test_noise_alone_passes_the_limit_as_rarely_as_said(rng: np.random.Generator) -> None:
    """5 of 100 are expected; more than 12 happen once in 500 times."""
    above = 0
    for _ in range(100):
        noise_m = 1e-9 * rng.standard_normal((512, 1, 1, 4))
        u_V = tones(rng)
        data = replace(
            answered(u_V, noise_m), displacement_m=1e-6 * u_V[:, None, None, None] + noise_m
        )
        found = detect_distortion(data)
        above += bool(found.level_m(even=True)[0] > found.limit_m(even=True)[0])
    assert above <= 12


def recorded(data: PeriodicData, name: str, realisation: int, drift_m: float = 0.0) -> Recording:
    """One realisation as a lab would keep it: rest, a ramp, then all periods in a row."""
    lead = np.concatenate([np.zeros(700), np.linspace(0.0, data.voltage_V[0, 0, realisation, 0])])
    periods = data.voltage_V[:, 0, realisation].T.ravel()
    moved_m = data.displacement_m[:, 0, realisation].T.ravel()
    drive_V = np.concatenate([lead, periods])
    answer_m = np.concatenate([np.full(len(lead), moved_m[0]), moved_m])
    answer_m += drift_m * np.arange(len(answer_m)) / len(answer_m)
    values = ((Quantity.VOLTAGE, drive_V), (Quantity.DISPLACEMENT, answer_m))
    return Recording(
        name=name,
        digest="sha256:0",
        axis="x",
        sampling_rate_Hz=data.sampling_rate_Hz,
        channels=tuple(Channel(quantity=q, axis="x", values=v, label=q.name) for q, v in values),
    )


def test_a_multisine_is_found_after_rest_and_ramp_and_a_chirp_is_not(
    rng: np.random.Generator,
) -> None:
    held = recorded(record(rng, silent=4), "multisine.csv", 0)
    found = find_repetition(held.voltage_V())
    assert found is not None
    assert found.period_samples == PERIOD
    assert found.periods == 4
    assert 740 <= found.first <= 750
    chirp = np.sin(np.linspace(0.0, 30.0, 5000) ** 2)
    assert find_repetition(chirp) is None
    assert find_repetition(np.zeros(100)) is None


def test_a_sine_repeats_but_has_no_silent_lines_to_read() -> None:
    sine = np.sin(2.0 * np.pi * np.arange(5000) / 100)
    assert find_repetition(sine) == Repetition(first=0, period_samples=100, periods=50)
    data = answered(sine[:512], np.zeros((512, 1, 1, 4)))
    drive = replace(recorded(data, "sine.csv", 0), sampling_rate_Hz=1000.0)
    assert distortion_of([drive], "x") == ()


def test_of_two_stretches_that_repeat_the_longer_counts(rng: np.random.Generator) -> None:
    period = rng.standard_normal(200)
    for before, after in ((9, 3), (3, 9)):
        parts = [np.tile(period, before), rng.standard_normal(90), np.tile(period, after)]
        found = find_repetition(np.concatenate(parts))
        assert found is not None
        assert (found.period_samples, found.periods) == (200, 9)
        assert abs(found.first - (0 if before == 9 else 3 * 200 + 90)) <= 1


def test_straight_drift_of_the_stage_is_not_taken_for_distortion(rng: np.random.Generator) -> None:
    data = record(rng, silent=4, noise_m=1e-10)
    straight, drifting = (
        distortion_of([recorded(data, f"{r}.csv", r, drift_m) for r in range(4)], "x")[0]
        for drift_m in (0.0, 5e-7)
    )
    assert straight.realisations == 4
    for even in (True, False):
        assert drifting.level_m(even=even) == pytest.approx(straight.level_m(even=even), abs=1e-12)


def test_the_report_shows_driven_and_silent_lines_with_their_levels(
    rng: np.random.Generator,
) -> None:
    data = record(rng, silent=4, noise_m=1e-9, cubic=0.05)
    held = [recorded(data, f"multisine_{r}.csv", r) for r in range(2)]
    page = render(Page(model=stage_model(axis_model()), recordings=held))
    assert "driven and silent lines of multisine_0.csv, multisine_1.csv" in page
    assert "2 realisations of 3 periods" in page
    assert "even distortion below" in page
    assert f"At 500{NARROW}mV rms" in page
