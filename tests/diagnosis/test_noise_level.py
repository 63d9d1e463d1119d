"""Nonuniform noise is a finding with its coordinate and its levels."""

from collections.abc import Callable, Iterable

import numpy as np
import pytest

from benchmarks.zoo.stages import draw_stage, stage
from piezoid.diagnosis.diagnose import diagnose, view_on
from piezoid.diagnosis.signals import with_displacement
from piezoid.diagnosis.structure_findings import NoiseLevel, noise_level
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.lab import Lab, read_lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign
from tests.journeys.test_batch import write_stages

from .bench import causes, finding_of, read_campaign, thinned
from .play_stage import NOISE_m, clean, view_with

pytestmark = pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")

ADDED_NOISE_m = 60e-9  # in addition to the sensor noise
Level = Callable[[Recording], Array]  # (recording) -> (samples,) as fractions of ADDED_NOISE_m


def level_by_position(recording: Recording) -> Array:
    displacement_m = recording.displacement_m()
    return np.asarray((displacement_m - displacement_m.min()) / np.ptp(displacement_m)) ** 2


def level_by_speed(recording: Recording) -> Array:
    speed = np.abs(np.gradient(recording.voltage_V()))
    return np.asarray(np.minimum(speed / np.quantile(speed, 0.9), 1.0))


def noisy_stage(level: Level) -> tuple[tuple[Recording, ...], Lab, float]:
    recordings, lab = read_campaign(draw_campaign(41, truth="bouc_wen", plans=("sweep", "rates")))
    rng, noisy, added_variances_m2 = np.random.default_rng(3), [], []
    for recording in recordings:
        sigma_m = ADDED_NOISE_m * level(recording)
        added_variances_m2.append(np.mean(sigma_m**2))
        noise_m = sigma_m * rng.standard_normal(len(sigma_m))
        noisy.append(with_displacement(recording, recording.displacement_m() + noise_m))
    return tuple(noisy), lab, float(np.sqrt(np.mean(added_variances_m2)))


@pytest.mark.slow
def test_noise_that_grows_with_position_is_a_finding_with_its_coordinate():
    noisy, lab, added_rms_m = noisy_stage(level_by_position)
    diagnosis = diagnose(thinned(noisy, 3), lab=lab)
    assert causes(diagnosis) == ("something_else",)
    finding = finding_of(diagnosis, "something_else")
    assert finding.coordinate in {"displacement", "reading"}
    assert finding.size.value == pytest.approx(1e9 * added_rms_m, rel=0.25)
    assert finding.held_out_gain == 0.0
    assert "noise of the readings changes along the displacement" in finding.explanation
    assert max(finding.seen.fitted_m) > 3.0 * min(finding.seen.fitted_m)


def noise_level_of(recordings: Iterable[Recording], lab: Lab) -> NoiseLevel | None:
    return noise_level(view_on(recordings, axis="x", lab=lab))


def test_noise_that_grows_with_speed_has_speed_as_its_coordinate():
    noisy, lab, _ = noisy_stage(level_by_speed)
    level = noise_level_of(noisy, lab)
    assert level.score.basis.coordinate == "speed"
    assert level.range[1] > 3.0 * level.range[0]


def test_uniform_noise_has_no_coordinate(tmp_path):
    """Signs alone give a false alarm on the second stage; the third has few samples."""
    noisy, lab, _ = noisy_stage(lambda recording: np.full(len(recording.voltage_V()), 0.3))
    assert noise_level_of(noisy, lab) is None
    assert (
        noise_level_of(*read_campaign(draw_stage(stage("lugre", "healthy", 1, 3_300_000)))) is None
    )
    folder = write_stages(tmp_path) / "unit-1"
    lab = read_lab(folder / "lab.toml")
    assert noise_level_of(collect([folder / "sweep.csv"], lab).recordings, lab) is None


@pytest.mark.parametrize(("wave_m", "is_stated"), [(0.0, True), (20 * ADDED_NOISE_m, False)])
def test_a_noise_level_is_stated_if_most_of_the_residual_is_noise(wave_m, is_stated):
    recordings, lab, _ = noisy_stage(level_by_position)
    disturbed = []
    for recording in recordings:
        wave = np.sin(
            2.0 * np.pi * 1.7 * np.arange(recording.samples) / recording.sampling_rate_Hz
        )
        disturbed.append(with_displacement(recording, recording.displacement_m() + wave_m * wave))
    assert (noise_level_of(disturbed, lab) is not None) is is_stated


def test_hum_at_every_other_sample_raises_the_noise_by_its_rms():
    reading_m, hum_m = clean("walk")[2], 4.0 * NOISE_m
    view = view_with(walk=reading_m + hum_m * (-1.0) ** np.arange(len(reading_m)))
    truth_m = np.sqrt(NOISE_m**2 + hum_m**2 / len(view.tracks))
    assert np.isclose(view.noise * view.half_stroke_m, truth_m, rtol=0.1)
