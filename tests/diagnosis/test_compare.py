"""Since a model was fitted: nothing, another sensitivity, or more than that."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.diagnosis.compare import compare
from piezoid.identification.extensions import FirstOrderLag, GainChange, ThermalDrift
from piezoid.identification.quality import Verdict
from tests.identification.joint.stage import NOISE_m, known_model, recordings_of


def test_a_model_that_still_holds_is_said_to_hold() -> None:
    found = compare(known_model(), recordings_of())
    assert "still holds" in found.statement.text
    assert found.unchanged_error_m < 1.3 * NOISE_m
    value, low, high = found.gain_ratio
    assert low <= 1.0 <= high
    assert value == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize(("ratio", "said"), [(1.03, "more than"), (0.88, "less than")])
def test_another_sensitivity_is_measured_and_explains_the_error(ratio: float, said: str) -> None:
    change = GainChange(recording="slow.csv", instant_s=0.0, ratio=ratio, later=("fast.csv",))
    found = compare(known_model(), recordings_of(change))
    assert found.gain_ratio[0] == pytest.approx(ratio, abs=2e-3)
    assert said in found.statement.text
    assert found.unchanged_error_m > 5 * NOISE_m
    assert found.rescaled_error_m < 1.3 * NOISE_m


def test_more_than_a_sensitivity_is_not_given_to_it() -> None:
    found = compare(known_model(), recordings_of(FirstOrderLag(lag_s=0.01)))
    assert "more than the sensitivity changed" in found.statement.text
    assert found.refitted_error_m < 0.9 * found.rescaled_error_m


def with_readings(recording, displacement_m):
    channels = tuple(
        replace(channel, values=displacement_m) if channel.label == "y" else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


def test_a_sensitivity_is_told_beside_sparks_as_in_a_clean_file() -> None:
    more = GainChange(recording="slow.csv", instant_s=0.0, ratio=1.12, later=("fast.csv",))
    sparked = []
    for recording in recordings_of(more):
        reading_m = np.array(recording.displacement_m())
        reading_m[77::83] += 0.4e-6
        sparked.append(with_readings(recording, reading_m))
    found = compare(known_model(), sparked)
    assert found.gain_ratio[0] == pytest.approx(1.12, abs=2e-3)
    assert "only the sensitivity changed" in found.statement.text
    assert "12." in found.statement.text
    assert not found.holds


def test_a_model_of_another_stage_does_not_hold_and_the_figure_says_so() -> None:
    strange = [
        with_readings(recording, 2e-6 * np.sin(np.arange(recording.samples) / 97.0))
        for recording in recordings_of()
    ]
    found = compare(known_model(), strange)
    assert not found.holds
    assert "does not hold" in found.statement.text
    assert "% of the motion" in found.statement.text


def test_no_sensitivity_is_told_where_the_search_ran_into_its_end() -> None:
    strange = [
        with_readings(
            recording, np.cumsum(np.random.default_rng(7).normal(size=recording.samples)) / 1e7
        )
        for recording in recordings_of()
    ]
    found = compare(known_model(), strange)
    assert "does not hold" in found.statement.text
    assert "90.00" not in found.statement.text
    assert "e+" not in found.statement.text


def test_a_noisier_sensor_is_no_other_stage() -> None:
    rng = np.random.default_rng(5)
    noisy = [
        with_readings(
            recording,
            recording.displacement_m() + 5 * NOISE_m * rng.normal(size=recording.samples),
        )
        for recording in recordings_of()
    ]
    found = compare(known_model(), noisy)
    assert "still holds" in found.statement.text
    assert "sensor noise rose" in found.statement.text


def test_a_model_that_never_applied_holds_nowhere() -> None:
    never = replace(known_model(), verdict=Verdict(applies=False, reason="loops turn back"))
    found = compare(never, recordings_of())
    assert not found.holds
    assert "still holds" not in found.statement.text
    assert "loops turn back" in found.statement.text


def test_what_belonged_to_the_recordings_of_then_is_left_behind() -> None:
    drift = ThermalDrift.of([])
    old = replace(known_model(), extensions=(drift,))
    assert (
        compare(old, recordings_of()).to_json()
        == compare(known_model(), recordings_of()).to_json()
    )
