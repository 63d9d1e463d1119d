"""Noise that is not the same everywhere is said to be, with its place and its levels."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.zoo.stages import draw_stage as drawn
from benchmarks.zoo.stages import stage
from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.signals import with_displacement
from piezoid.diagnosis.structure_findings import NoiseLevel, noise_level
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from tests.journeys.test_batch import write_night

from .bench import causes, recorded, thinned
from .play_stage import NOISE_m, clean, view_with

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order")

LOUD_m = 60e-9  # beyond the sensor's own noise
Level = Callable[[Recording], Array]  # (recording) -> (samples,) parts of LOUD_m


def by_place(recording: Recording) -> Array:
    moved_m = recording.displacement_m()
    return np.asarray((moved_m - moved_m.min()) / np.ptp(moved_m)) ** 2


def by_speed(recording: Recording) -> Array:
    speed = np.abs(np.gradient(recording.voltage_V()))
    return np.asarray(np.minimum(speed / np.quantile(speed, 0.9), 1.0))


def noisy_stage(level: Level) -> tuple[tuple[Recording, ...], Lab, float]:
    recordings, lab = recorded(draw_campaign(41, truth="bouc_wen", plans=("sweep", "rates")))
    chance, noisy, more_m2 = np.random.default_rng(3), [], []
    for one in recordings:
        sigma_m = LOUD_m * level(one)
        more_m2.append(np.mean(sigma_m**2))
        noise_m = sigma_m * chance.standard_normal(len(sigma_m))
        noisy.append(with_displacement(one, one.displacement_m() + noise_m))
    return tuple(noisy), lab, float(np.sqrt(np.mean(more_m2)))


@pytest.mark.slow
def test_noise_that_grows_with_position_is_a_finding_with_its_place() -> None:
    noisy, lab, more_m = noisy_stage(by_place)
    diagnosis = diagnose(thinned(noisy, 3), lab=lab)
    assert causes(diagnosis) == ("something_else",)
    (finding,) = (named for named in diagnosis.findings if named.effect == "something_else")
    assert finding.coordinate in {"displacement", "reading"}
    assert finding.size.value == pytest.approx(1e9 * more_m, rel=0.25)
    assert finding.held_out_gain == 0.0
    assert "noise of the readings changes along the displacement" in finding.explanation
    assert finding.seen is not None
    assert max(finding.seen.fitted_m) > 3.0 * min(finding.seen.fitted_m)


def level_in(recordings: Iterable[Recording], lab: Lab) -> NoiseLevel | None:
    return noise_level(view_on(recordings, axis="x", lab=lab), 0.02)


def test_noise_that_grows_with_speed_is_told_by_the_speed() -> None:
    noisy, lab, _ = noisy_stage(by_speed)
    level = level_in(noisy, lab)
    assert level is not None
    assert level.score.basis.coordinate == "speed"
    assert level.range[1] > 3.0 * level.range[0]


def test_noise_that_is_the_same_everywhere_has_no_place(tmp_path: Path) -> None:
    """Chance signs alone would accuse the second stage; the third has few samples."""
    noisy, lab, _ = noisy_stage(lambda one: np.full(len(one.voltage_V()), 0.3))
    assert level_in(noisy, lab) is None
    assert level_in(*recorded(drawn(stage("lugre", "healthy", 1, 3_300_000)))) is None
    night = write_night(tmp_path) / "unit-1"
    lab = read_lab(night / "lab.toml")
    assert level_in(collect([night / "sweep.csv"], lab).recordings, lab) is None


@pytest.mark.parametrize(("wave_m", "is_told"), [(0.0, True), (20 * LOUD_m, False)])
def test_noise_is_told_where_most_of_what_is_left_is_noise(wave_m: float, is_told: bool) -> None:
    recordings, lab, _ = noisy_stage(by_place)
    waved = []
    for one in recordings:
        wave = np.sin(2.0 * np.pi * 1.7 * np.arange(one.samples) / one.sampling_rate_Hz)
        waved.append(with_displacement(one, one.displacement_m() + wave_m * wave))
    assert (level_in(waved, lab) is not None) is is_told


def test_a_hum_at_every_other_sample_is_no_more_noise_than_it_leaves() -> None:
    reading_m, hum_m = clean("walk")[2], 4.0 * NOISE_m
    view = view_with(walk=reading_m + hum_m * (-1.0) ** np.arange(len(reading_m)))
    truth_m = np.sqrt(NOISE_m**2 + hum_m**2 / len(view.tracks))
    assert np.isclose(view.noise * view.half_stroke_m, truth_m, rtol=0.1)
