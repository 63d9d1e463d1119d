"""Hysteresis is placed before a mode, behind it or inside, or said not to be separable."""

import numpy as np
import pytest
from scipy.signal import resample

import piezoid
from benchmarks.records.placed_stages import SAMPLES, mode_of, multisine, stage
from piezoid_datasets.virtual_lab.truths import preisach

RATE_HZ = 5000.0


def recorded(drive: np.ndarray, motion: np.ndarray) -> piezoid.Recording:
    noise = 1e-3 * motion.std() * np.random.default_rng(5).standard_normal(len(motion))
    return piezoid.from_arrays(
        voltage_V=75.0 + 75.0 * drive,
        displacement_m=1e-5 * (motion + noise),
        sampling_rate_Hz=RATE_HZ,
    )


@pytest.mark.parametrize(("place", "seed"), [("before", 9102), ("behind", 9102), ("inside", 9104)])
def test_hysteresis_of_a_strange_law_is_placed(place: str, seed: int) -> None:
    recording, _ = stage(place, seed)
    found = piezoid.place_hysteresis(recording, hold="band_limited")
    others = [rms for name, rms in found.left_out_rms_m.items() if name != place]
    assert found.place == place
    assert found.margin == pytest.approx(min(others) / found.left_out_rms_m[place])
    assert min(others) > 1.3 * found.left_out_rms_m[place]
    assert found.without_rms_m > 1.3 * found.left_out_rms_m[place]
    assert found.text.startswith("The hysteresis stands ")
    assert f"{found.left_out_rms_m[place]:.3g} m against" in found.text
    assert found.text.split(":")[0] in found._repr_html_()


def test_far_below_the_mode_no_place_can_be_told_and_an_experiment_is_named() -> None:
    drive = multisine(np.random.default_rng(3), 0.006)  # 20 to 30 Hz
    strain = sum(preisach.TRUTH.draw(np.random.default_rng(2)).respond(drive, np.array([0.0])))
    found = piezoid.place_hysteresis(recorded(drive, strain), hold="band_limited")
    assert found.place == "not separable"
    assert "ot separable on this recording" in found.text
    assert "ecord a random-phase multisine from" in found.text


def test_where_two_places_predict_alike_a_better_experiment_is_named() -> None:
    recording, _ = stage("inside", 9101)
    found = piezoid.place_hysteresis(recording, hold="band_limited")
    assert found.place == "not separable"
    assert found.margin < 1.1
    assert "predict left-out blocks alike" in found.text
    assert f"from {0.1 * found.mode_Hz:.3g} to {3.0 * found.mode_Hz:.3g} Hz" in found.text


def test_a_recording_without_a_mode_is_told_so_and_what_to_record() -> None:
    drive = multisine(np.random.default_rng(3), 0.1)
    line = recorded(drive, 0.5 * drive)
    found = piezoid.place_hysteresis(line)
    assert found.place == "not separable"
    assert found.text.startswith("Not separable on this recording: a straight line predicts")
    assert found.text in found._repr_html_().replace("&#x27;", "'")
    with pytest.raises(
        piezoid.PiezoidError, match=r"does no better\. Needed: a recording in which the mo"
    ):
        piezoid.identify_restoring_force(line)


def test_a_mode_without_hysteresis_is_said_to_have_none() -> None:
    drive = multisine(np.random.default_rng(4), 0.1)
    fine = resample(drive, 8 * SAMPLES)
    motion = mode_of(fine, 200.0, 0.05, 8 * RATE_HZ)[::8]
    found = piezoid.place_hysteresis(recorded(drive, motion), hold="band_limited")
    assert found.place == "not separable"
    assert "without hysteresis predicts as well" in found.text
    assert "through 2" in found.text
    assert found.mode_Hz == pytest.approx(200.0, rel=0.01)


@pytest.mark.parametrize("late", [0, 12])  # of FINE parts of a sample
def test_a_linear_mode_that_is_late_or_held_otherwise_is_not_placed(late: int) -> None:
    """Plays in front of a mode turn its phase, and would be taken for what a delay does."""
    fine, drive = 16, multisine(np.random.default_rng(4), 0.1)[: SAMPLES // 2]
    moved = mode_of(resample(drive, fine * len(drive)), 200.0, 0.03, fine * RATE_HZ)
    motion = np.roll(moved, late)[::fine]
    found = piezoid.place_hysteresis(recorded(drive, motion), hold="zero_order")
    assert found.place == "not separable"
    assert found.without_rms_m is not None
    assert found.without_rms_m < 1.02 * min(found.left_out_rms_m.values())
