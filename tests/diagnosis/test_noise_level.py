"""Noise that is not the same everywhere is said to be, with its place and its levels."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks.zoo.stages import drawn, stage
from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.noise_level import noise_level
from piezoid.diagnosis.signals import with_displacement
from piezoid.numerics.arrays import Array
from piezoid.records.ingest import ingest_all
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from tests.journeys.test_batch import write_night

from .bench import causes, recorded

LOUD_m = 60e-9  # beyond the sensor's own noise
Level = Callable[[Recording], Array]  # (recording) -> (samples,) parts of LOUD_m


def by_place(recording: Recording) -> Array:
    moved_m = recording.displacement_m()
    return np.asarray((moved_m - moved_m.min()) / np.ptp(moved_m)) ** 2


def by_speed(recording: Recording) -> Array:
    speed = np.abs(np.gradient(recording.voltage_V()))
    return np.asarray(np.minimum(speed / np.quantile(speed, 0.9), 1.0))


def diagnosed(level: Level) -> tuple[Diagnosis, float]:
    """Return what is said of a healthy stage with more noise, and how much more, rms."""
    noisy, lab, more_m = noisy_stage(level)
    return diagnose(noisy, lab=lab), more_m


def noisy_stage(level: Level) -> tuple[tuple[Recording, ...], Lab, float]:
    recordings, lab = recorded(draw_campaign(41, truth="bouc_wen", plans=("sweep", "rates")))
    chance, noisy, more_m2 = np.random.default_rng(3), [], []
    for one in recordings:
        sigma_m = LOUD_m * level(one)
        more_m2.append(np.mean(sigma_m**2))
        noise_m = sigma_m * chance.standard_normal(len(sigma_m))
        noisy.append(with_displacement(one, one.displacement_m() + noise_m))
    return tuple(noisy), lab, float(np.sqrt(np.mean(more_m2)))


@pytest.mark.parametrize(
    ("level", "coordinates"),
    [(by_place, {"displacement", "reading"}), (by_speed, {"speed"})],
)
def test_noise_that_lives_somewhere_is_told_with_its_place(
    level: Level, coordinates: set[str]
) -> None:
    found, more_m = diagnosed(level)
    assert causes(found) == ("something_else",)
    (finding,) = (named for named in found.findings if named.effect == "something_else")
    assert finding.coordinate in coordinates
    assert finding.size.value == pytest.approx(1e9 * more_m, rel=0.25)
    assert finding.held_out_gain == 0.0
    assert "the noise of the readings is not the same everywhere" in finding.explanation
    assert finding.seen is not None
    assert max(finding.seen.fitted_m) > 3.0 * min(finding.seen.fitted_m)


def test_noise_that_is_the_same_everywhere_is_no_finding() -> None:
    found, _ = diagnosed(lambda one: np.full(len(one.voltage_V()), 0.3))
    assert not causes(found)


def test_a_healthy_stage_on_which_chance_signs_alone_would_accuse_the_noise_is_not_accused() -> (
    None
):
    recordings, lab = recorded(drawn(stage("lugre", "healthy", 1, 3_300_000)))
    assert not causes(diagnose(recordings, lab=lab))


def test_a_loop_of_few_samples_has_no_noise_that_lives_in_its_corners(tmp_path: Path) -> None:
    stage = write_night(tmp_path) / "unit-1"
    lab = read_lab(stage / "lab.toml")
    assert not causes(diagnose(ingest_all([stage / "sweep.csv"], lab), lab=lab))


@pytest.mark.parametrize(("wave_m", "is_told"), [(0.0, True), (20 * LOUD_m, False)])
def test_noise_is_told_where_most_of_what_is_left_is_noise(wave_m: float, is_told: bool) -> None:
    recordings, lab, _ = noisy_stage(by_place)
    waved = []
    for one in recordings:
        wave = np.sin(2.0 * np.pi * 1.7 * np.arange(one.samples) / one.sampling_rate_Hz)
        waved.append(with_displacement(one, one.displacement_m() + wave_m * wave))
    found = noise_level(view_on(waved, axis="x", lab=lab), 0.02)
    assert (found is not None) is is_told
