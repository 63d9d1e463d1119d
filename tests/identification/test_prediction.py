"""Predictions of recordings that were not fitted, compared with the truth."""

import numpy as np
import pytest

import piezoid
from piezoid.errors import IdentificationError, RecordingError
from piezoid.identification.actuator_model import parameters_of
from tests.api.stage import NOISE_m, RATE_Hz, fitted, recorded, truth, unseen_drive

RANGE_m = 2.2e-5


def test_a_new_recording_is_predicted_accurately():
    _, model = fitted()
    drive_V = unseen_drive()
    unseen = recorded(drive_V, 2, "unseen", before_V=3.0, zero_m=4e-6)
    error_m = model.predict(unseen) - truth(drive_V, 3.0, 4e-6)
    assert np.sqrt(np.mean(error_m**2)) < 1e-3 * RANGE_m
    comparison = model.compare(unseen)
    assert comparison.rms_m == pytest.approx(np.sqrt(np.mean(comparison.error_m**2)))
    assert comparison.rms_m < 2e-3 * RANGE_m
    assert comparison.rms_percent == pytest.approx(
        100 * comparison.rms_m / np.ptp(unseen.displacement_m())
    )


def test_only_initial_state_and_zero_are_fitted_to_a_new_recording():
    """A stage with 5 % more displacement shows its full error."""
    _, model = fitted()
    drive_V = unseen_drive()
    scaled = piezoid.from_arrays(
        sampling_rate_Hz=RATE_Hz, voltage_V=drive_V, displacement_m=1.05 * truth(drive_V)
    )
    error_m = 0.05 * np.std(truth(drive_V))
    assert model.compare(scaled).rms_m == pytest.approx(error_m, rel=0.1)


def test_a_new_recording_with_a_fitted_name_has_its_own_initial_state():
    _, model = fitted()
    namesake = recorded(unseen_drive(), 3, "sweep", before_V=-4.0, zero_m=-9e-6)
    assert model.compare(namesake).rms_m < 2e-3 * RANGE_m


def test_a_fitted_recording_is_reproduced_to_its_noise():
    sweep, model = fitted()
    assert model.compare(sweep).rms_m < 2.5 * NOISE_m


def test_a_drive_alone_is_predicted_from_the_demagnetised_state():
    _, model = fitted()
    drive_V = unseen_drive()
    drive_only = piezoid.from_arrays(sampling_rate_Hz=RATE_Hz, voltage_V=drive_V)
    predicted_m = model.predict(drive_only)
    assert np.array_equal(predicted_m, model.simulate(drive_V, RATE_Hz))
    assert np.std(predicted_m - truth(drive_V)) < 5e-3 * RANGE_m
    with pytest.raises(RecordingError, match="no displacement"):
        model.compare(drive_only)


def test_every_piece_between_breaks_has_its_own_initial_state():
    _, model = fitted()
    frame = piezoid.to_frame(recorded(unseen_drive(), 4, "torn"))
    frame.iloc[1000, 1:] = np.nan
    frame.loc[frame.index > 1000, "displacement_x_m"] += 5e-6  # a change of the zero in the gap
    interrupted = piezoid.from_frame(frame)
    assert interrupted.breaks == (1000,)
    assert model.compare(interrupted).rms_m < 2e-3 * RANGE_m


def test_the_inverse_produces_the_reference_displacement():
    _, model = fitted()
    axis = model["x"]
    reference_m = axis.zero_m + 6e-6 * np.sin(np.linspace(0.0, 20.0, 2000))
    voltage_V = model.inverse(reference_m)
    output_m, _ = axis.hysteresis.run(voltage_V, axis.virgin_memory_V)
    assert np.allclose(output_m, reference_m, rtol=0.0, atol=1e-12)
    assert np.std(truth(voltage_V) - reference_m) < 5e-3 * RANGE_m


def test_parameters_contain_the_truth_in_their_intervals():
    _, model = fitted()
    table = parameters_of(model["x"])
    assert list(table.columns) == ["value", "unit", "low", "high"]
    play_weights = table[table.index.str.startswith("play_weight")]
    assert set(play_weights["unit"]) == {"m/V"}
    assert play_weights["value"].sum() == pytest.approx(TOTAL_WEIGHT_m_per_V, rel=0.03)
    bounded = table.dropna()
    assert (bounded["low"] <= bounded["value"]).all()
    assert (bounded["value"] <= bounded["high"] * (1 + 1e-12) + 1e-30).all()
    assert model.parameters().loc["x"].equals(table.rename_axis("name"))


TOTAL_WEIGHT_m_per_V = 3.2e-6


def test_the_linear_part_converts_to_scipy_and_control():
    control = pytest.importorskip("control")
    _, model = fitted()
    system = model.to_scipy(1000.0)
    gain = system.C @ np.linalg.solve(np.eye(len(system.A)) - system.A, system.B) + system.D
    middle = 0.5 * sum(model["x"].hysteresis.slope_sector_m_per_V)
    assert gain[0, 0] == pytest.approx(middle, rel=1e-9)
    assert control.dcgain(model.to_control(1000.0)) == pytest.approx(middle, rel=1e-9)
    assert system.dt == 1e-3


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.simulate(np.zeros((3, 2)), 500.0), "shape .3, 2."),
        (lambda m: m.simulate([0.0, np.nan], 500.0), "nan at sample 1"),
        (lambda m: m.simulate([0.0, 1.0], 500.0, np.zeros(99)), "memory of shape .99,."),
        (lambda m: m.inverse(np.zeros(0)), "shape .0,."),
        (lambda m: m.simulate([0.0], 500.0, axis="q"), "no axis 'q'"),
        (lambda m: m.to_scipy(-1.0), "sampling rate of -1.0 Hz"),
    ],
)
def test_invalid_signals_are_refused_with_a_reason(call, message):
    _, model = fitted()
    with pytest.raises((RecordingError, IdentificationError), match=message):
        call(model)
