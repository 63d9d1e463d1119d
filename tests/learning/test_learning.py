"""Learning feedforward: convergence on plants that differ from the model, and refusals."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.errors import DesignError, ParameterFileError, RecordingError
from piezoid.learning.contraction import learning_filter, table_response
from piezoid.learning.learn import (
    first_table,
    learned_from_json,
    measured_response,
    next_table,
    refuse_changed,
)
from piezoid.learning.period import learning_shares, play
from piezoid.numerics.polynomial import unit_circle
from piezoid.records.frames import from_arrays
from piezoid.verification.closed_loop import reference_range
from piezoid.verification.plant import CustomResponse, lateral_plant
from piezoid.verification.scenarios import raster
from tests.targets.known_inputs import chain, exported
from tests.verification.known_fit import fitted
from tests.verification.rig import GAIN_m_per_V, RATE_Hz, lateral, lateral_parameters

POINTS = 200  # 100 Hz
TOLERANCE = 0.02  # the loop has substeps; a response without feedback differs by 30 %
AXIS = fitted()["x"]
PLANT = lateral_plant(AXIS, sampling_rate_Hz=RATE_Hz)


def shipped():
    return exported().lateral[0]


def triangle(share=0.5):
    room = reference_range(shipped())
    unit = raster(RATE_Hz, RATE_Hz / POINTS, 1.0).x
    return room.centre_m + share * room.farthest_m * unit


@cache
def first_learned(closed=True):
    return first_table(AXIS, PLANT, triangle(), parameters=shipped() if closed else None)


def different_plant():
    """Return a plant whose play weights differ from the model by up to 30 %."""
    plays = PLANT.response.operator.plays
    weight = plays.weight * np.linspace(0.97, 1.3, len(plays.weight))
    operator = replace(PLANT.response.operator, plays=replace(plays, weight=weight))
    return replace(PLANT, response=replace(PLANT.response, operator=operator))


def recorded(run, **overrides):
    arguments = {
        "voltage_V": run.voltage_V,
        "displacement_m": run.measured,
        "sampling_rate_Hz": RATE_Hz,
    }
    return from_arrays(**{**arguments, **overrides})


@pytest.mark.parametrize("closed", [True, False])
def test_three_periods_reduce_the_error_of_a_different_plant_below_the_noise(closed):
    learned, parameters = first_learned(closed), shipped() if closed else None
    values, rng = parameters and parameters.values, np.random.default_rng(1)
    errors_m = []
    for _ in range(3):
        run = play(different_plant(), learned.wanted_m, learned.table_V, values=values, rng=rng)
        error_m = learned.wanted_m - run.position
        errors_m.append(float(np.std(error_m)))
        learned = next_table(learned, AXIS, PLANT, recorded(run), parameters=parameters)
    assert errors_m[0] > 3 * PLANT.noise_rms
    assert errors_m[1] < learned.contraction * errors_m[0]
    assert errors_m[-1] < PLANT.noise_rms
    assert len(learned.errors_m) == 3
    read = learned_from_json(learned.to_json(), "learning.json")
    assert read.to_json() == learned.to_json()


def test_the_table_moves_the_plant_by_the_computed_response():
    linear = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v), noise_rms=0.0
    )
    values = lateral_parameters().for_method("dob").values
    table_V = 0.5 * np.sin(2 * np.pi * np.arange(POINTS) / POINTS)
    rest_m = np.zeros(POINTS)
    rng = np.random.default_rng(0)
    position_m = play(linear, rest_m, table_V, values=values, rng=rng).position
    q = unit_circle(np.array([RATE_Hz / POINTS]), RATE_Hz)
    expected = table_response(plant_from_chain(chain()), values, q)[0]
    response = np.fft.rfft(position_m)[1] / np.fft.rfft(table_V)[1]
    assert abs(response - expected) < TOLERANCE * abs(expected)


def test_the_response_is_measured_only_where_the_table_changes_clearly():
    filter_ = learning_filter(AXIS, shipped().values, points=POINTS, sampling_rate_Hz=RATE_Hz)
    rng, noise_m, harmonics = np.random.default_rng(2), 1e-9, len(filter_.learns)
    response_m_per_V = 2e-7 * np.exp(-0.3j * np.arange(harmonics))
    change_V = np.zeros(harmonics, dtype=complex)
    change_V[7], change_V[9] = 2.0 * POINTS * noise_m / 2e-7, 0.02 * POINTS * noise_m / 2e-7
    displacement_m = np.fft.irfft(change_V * response_m_per_V * filter_.sensed, POINTS)
    reading_m = displacement_m + np.sqrt(2.0) * noise_m * rng.standard_normal(POINTS)
    table_V = np.fft.irfft(change_V, POINTS)
    prior = np.zeros(harmonics, dtype=complex)
    estimate = measured_response(table_V, reading_m, noise_m, prior, filter_)
    assert estimate[7] == pytest.approx(response_m_per_V[7], rel=0.1)
    assert np.flatnonzero(np.abs(estimate)).tolist() == [7]
    with np.errstate(invalid="ignore"):
        repeated = measured_response(
            np.zeros(POINTS), np.zeros(POINTS), noise_m, estimate, filter_
        )
    assert repeated.tolist() == estimate.tolist()  # a previous estimate is kept


def test_noise_is_hardly_learnt_and_a_larger_error_almost_completely():
    noise = np.fft.rfft(np.random.default_rng(3).normal(0.0, 5e-9, 4000))
    shares = learning_shares(noise, 4000, 5e-9)
    assert np.mean(shares > 0) == pytest.approx(np.exp(-4.0), abs=0.01)
    assert learning_shares(noise + 1e-4, 4000, 5e-9).min() > 0.99


def test_a_filter_that_does_not_contract_is_refused():
    contracting = learning_filter(AXIS, None, points=POINTS, sampling_rate_Hz=RATE_Hz)
    assert contracting.sector < contracting.contraction < 1.0
    with pytest.raises(DesignError, match=r"does not contract: at 100 Hz.*leave 1\.\d+ of"):
        first_table(AXIS, PLANT, triangle(), parameters=shipped(), gain=2.2)


def test_a_reference_beyond_range_or_slew_rate_is_refused():
    with pytest.raises(ParameterFileError, match=r"the reference is from .* to .* within"):
        first_table(AXIS, PLANT, triangle(1.2), parameters=shipped())
    limited = replace(PLANT, slew_V_per_s=100.0)
    with pytest.raises(ParameterFileError, match=r"moves at up to .* at most"):
        first_table(AXIS, limited, triangle(), parameters=None)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"sampling_rate_Hz": 0.5 * RATE_Hz}, r"recorded at 10\.0000 kHz.*played at 20\.0000 kHz"),
        ({"rows": slice(0, 150)}, "150 samples, and a period has 200"),
        ({"late": 60}, "deviates from the period by .* from its row 60"),
        ({"scale": 1e3}, "deviates from the period by"),
    ],
)
def test_a_recording_of_another_period_is_refused(overrides, message):
    learned = first_learned()
    displacement_m = overrides.pop("scale", 1.0) * np.roll(
        learned.wanted_m, overrides.pop("late", 0)
    )
    rows = overrides.pop("rows", slice(None))
    arguments = {"voltage_V": learned.table_V[rows], "displacement_m": displacement_m[rows]}
    recording = from_arrays(**{**arguments, "sampling_rate_Hz": RATE_Hz, **overrides})
    with pytest.raises(RecordingError, match=message):
        next_table(learned, AXIS, PLANT, recording, parameters=shipped())


def test_a_table_of_another_reference_model_or_loop_is_refused():
    learned, changed_m = first_learned(), triangle()
    unchanged = {"sources": learned.sources, "closed_loop": learned.closed_loop}
    refuse_changed(learned, triangle(), **unchanged)
    changed_m[17] += 2e-9
    with pytest.raises(RecordingError, match=r"by up to 2\.00 nm, at point 17"):
        refuse_changed(learned, changed_m, **unchanged)
    with pytest.raises(ParameterFileError, match="learnt of another model"):
        refuse_changed(learned, triangle(), **{**unchanged, "sources": {"model": "x"}})
    with pytest.raises(ParameterFileError, match=r"learnt with(out)? a controller"):
        refuse_changed(
            learned, triangle(), **{**unchanged, "closed_loop": not learned.closed_loop}
        )
