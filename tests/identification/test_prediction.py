"""A model on recordings that its fit has not seen, against the truth that made them."""

import numpy as np
import pytest

import piezoid
from piezoid.errors import IdentificationError, RecordingError
from piezoid.identification.parameters import parameters_of
from tests.api.stage import NOISE_m, RATE_Hz, fitted, recorded, truth, unseen_drive

RANGE_m = 2.2e-5


def test_an_unseen_recording_is_predicted_near_the_truth():
    _, model = fitted()
    drive_V = unseen_drive()
    unseen = recorded(drive_V, 2, "unseen", before_V=3.0, zero_m=4e-6)
    error_m = model.predict(unseen) - truth(drive_V, 3.0, 4e-6)
    assert np.sqrt(np.mean(error_m**2)) < 1e-3 * RANGE_m
    found = model.compare(unseen)
    assert found.rms_m == pytest.approx(np.sqrt(np.mean(found.error_m**2)))
    assert found.rms_m < 2e-3 * RANGE_m
    assert found.rms_percent == pytest.approx(100 * found.rms_m / np.ptp(unseen.displacement_m()))


def test_only_memory_and_zero_are_taken_from_an_unseen_recording():
    """A stage that moves 5 % farther is not what was fitted, and that shows."""
    _, model = fitted()
    drive_V = unseen_drive()
    other = piezoid.from_arrays(
        sampling_rate_Hz=RATE_Hz, voltage_V=drive_V, displacement_m=1.05 * truth(drive_V)
    )
    lost_m = 0.05 * np.std(truth(drive_V))
    assert model.compare(other).rms_m == pytest.approx(lost_m, rel=0.1)


def test_another_recording_of_a_fitted_name_begins_where_it_begins():
    _, model = fitted()
    namesake = recorded(unseen_drive(), 3, "sweep", before_V=-4.0, zero_m=-9e-6)
    assert model.compare(namesake).rms_m < 2e-3 * RANGE_m


def test_a_recording_of_the_fit_is_followed_to_its_noise():
    sweep, model = fitted()
    assert model.compare(sweep).rms_m < 2.5 * NOISE_m


def test_a_drive_alone_is_predicted_from_the_de_poled_state():
    _, model = fitted()
    drive_V = unseen_drive()
    alone = piezoid.from_arrays(sampling_rate_Hz=RATE_Hz, voltage_V=drive_V)
    predicted_m = model.predict(alone)
    assert np.array_equal(predicted_m, model.simulate(drive_V, RATE_Hz))
    assert np.std(predicted_m - truth(drive_V)) < 5e-3 * RANGE_m
    with pytest.raises(RecordingError, match="no displacement"):
        model.compare(alone)


def test_every_piece_between_breaks_begins_anew():
    _, model = fitted()
    frame = piezoid.to_frame(recorded(unseen_drive(), 4, "torn"))
    frame.iloc[1000, 1:] = np.nan
    frame.loc[frame.index > 1000, "displacement_x_m"] += 5e-6  # the zero moved in the gap
    torn = piezoid.from_frame(frame)
    assert torn.breaks == (1000,)
    assert model.compare(torn).rms_m < 2e-3 * RANGE_m


def test_the_inverse_makes_the_wanted_displacement():
    _, model = fitted()
    axis = model["x"]
    wanted_m = axis.zero_m + 6e-6 * np.sin(np.linspace(0.0, 20.0, 2000))
    voltage_V = model.inverse(wanted_m)
    output_m, _ = axis.hysteresis.run(voltage_V, axis.virgin_memory_V)
    assert np.allclose(output_m, wanted_m, rtol=0.0, atol=1e-12)
    assert np.std(truth(voltage_V) - wanted_m) < 5e-3 * RANGE_m


def test_parameters_hold_the_truth_in_their_intervals():
    _, model = fitted()
    table = parameters_of(model["x"])
    assert list(table.columns) == ["value", "unit", "low", "high"]
    whole = table[table.index.str.startswith("play_weight")]
    assert set(whole["unit"]) == {"m/V"}
    assert whole["value"].sum() == pytest.approx(WHOLE_m_per_V, rel=0.03)
    known = table.dropna()
    assert (known["low"] <= known["value"]).all()
    assert (known["value"] <= known["high"] * (1 + 1e-12) + 1e-30).all()
    assert model.parameters().loc["x"].equals(table.rename_axis("name"))


WHOLE_m_per_V = 3.2e-6


def test_the_linear_part_goes_to_scipy_and_control():
    control = pytest.importorskip("control")
    _, model = fitted()
    system = model.to_scipy(1000.0)
    gain = system.C @ np.linalg.solve(np.eye(len(system.A)) - system.A, system.B) + system.D
    middle = 0.5 * sum(model["x"].hysteresis.slope_sector_m_per_V)
    assert gain[0, 0] == pytest.approx(middle, rel=1e-9)
    assert control.dcgain(model.to_control(1000.0)) == pytest.approx(middle, rel=1e-9)
    assert system.dt == 1e-3


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda m: m.simulate(np.zeros((3, 2)), 500.0), "shape .3, 2."),
        (lambda m: m.simulate([0.0, np.nan], 500.0), "nan at sample 1"),
        (lambda m: m.simulate([0.0, 1.0], 500.0, np.zeros(99)), "memory of shape .99,."),
        (lambda m: m.inverse(np.zeros(0)), "shape .0,."),
        (lambda m: m.simulate([0.0], 500.0, axis="q"), "no axis 'q'"),
        (lambda m: m.to_scipy(-1.0), "sampling rate of -1.0 Hz"),
    ],
)
def test_what_is_no_signal_is_refused_in_words(call, said):
    _, model = fitted()
    with pytest.raises((RecordingError, IdentificationError), match=said):
        call(model)
