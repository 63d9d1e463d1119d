"""Learning feedforward: what it promises on plants it was not computed from, what it refuses."""

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
WITHIN = 0.02  # the loop runs in substeps; a response without feedback is 30 % off
AXIS = fitted()["x"]
PLANT = lateral_plant(AXIS, sampling_rate_Hz=RATE_Hz)


def shipped():
    return exported().lateral[0]


def triangle(share=0.5):
    room = reference_range(shipped())
    unit = raster(RATE_Hz, RATE_Hz / POINTS, 1.0).x
    return room.centre_m + share * room.farthest_m * unit


@cache
def first(closed=True):
    return first_table(AXIS, PLANT, triangle(), parameters=shipped() if closed else None)


def stranger():
    """A plant whose plays are up to 30 % other than those of the model."""
    plays = PLANT.response.operator.plays
    weight = plays.weight * np.linspace(0.97, 1.3, len(plays.weight))
    operator = replace(PLANT.response.operator, plays=replace(plays, weight=weight))
    return replace(PLANT, response=replace(PLANT.response, operator=operator))


def recorded(played, **changed):
    given = {
        "voltage_V": played.voltage_V,
        "displacement_m": played.measured,
        "sampling_rate_Hz": RATE_Hz,
    }
    return from_arrays(**{**given, **changed})


@pytest.mark.parametrize("closed", [True, False])
def test_three_periods_bring_a_plant_of_other_hysteresis_below_the_noise(closed):
    learned, parameters = first(closed), shipped() if closed else None
    values, rng = parameters and parameters.values, np.random.default_rng(1)
    errors_m = []
    for _ in range(3):
        played = play(stranger(), learned.wanted_m, learned.table_V, values=values, rng=rng)
        error_m = learned.wanted_m - played.position
        errors_m.append(float(np.std(error_m)))
        learned = next_table(learned, AXIS, PLANT, recorded(played), parameters=parameters)
    assert errors_m[0] > 3 * PLANT.noise_rms
    assert errors_m[1] < learned.contraction * errors_m[0]
    assert errors_m[-1] < PLANT.noise_rms
    assert len(learned.errors_m) == 3
    again = learned_from_json(learned.to_json(), "learning.json")
    assert again.to_json() == learned.to_json()


def test_a_volt_of_the_table_moves_what_the_response_says():
    linear = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v), noise_rms=0.0
    )
    values = lateral_parameters().for_method("dob").values
    table_V = 0.5 * np.sin(2 * np.pi * np.arange(POINTS) / POINTS)
    rest_m = np.zeros(POINTS)
    rng = np.random.default_rng(0)
    moved = play(linear, rest_m, table_V, values=values, rng=rng).position
    q = unit_circle(np.array([RATE_Hz / POINTS]), RATE_Hz)
    said = table_response(plant_from_chain(chain()), values, q)[0]
    shown = np.fft.rfft(moved)[1] / np.fft.rfft(table_V)[1]
    assert abs(shown - said) < WITHIN * abs(said)


def test_two_periods_tell_the_response_where_the_table_asked_clearly_and_nowhere_else():
    found = learning_filter(AXIS, shipped().values, points=POINTS, sampling_rate_Hz=RATE_Hz)
    rng, noise_m, harmonics = np.random.default_rng(2), 1e-9, len(found.learns)
    true = 2e-7 * np.exp(-0.3j * np.arange(harmonics))
    asked = np.zeros(harmonics, dtype=complex)
    asked[7], asked[9] = 2.0 * POINTS * noise_m / 2e-7, 0.02 * POINTS * noise_m / 2e-7
    moved_m = np.fft.irfft(asked * true * found.sensed, POINTS)
    read_m = moved_m + np.sqrt(2.0) * noise_m * rng.standard_normal(POINTS)
    table_V = np.fft.irfft(asked, POINTS)
    unknown = np.zeros(harmonics, dtype=complex)
    shown = measured_response(table_V, read_m, noise_m, unknown, found)
    assert shown[7] == pytest.approx(true[7], rel=0.1)
    assert np.flatnonzero(np.abs(shown)).tolist() == [7]
    with np.errstate(invalid="ignore"):
        again = measured_response(np.zeros(POINTS), np.zeros(POINTS), noise_m, shown, found)
    assert again.tolist() == shown.tolist()  # what was measured once is kept


def test_noise_alone_is_hardly_learnt_and_an_error_beyond_it_nearly_all():
    noise = np.fft.rfft(np.random.default_rng(3).normal(0.0, 5e-9, 4000))
    shares = learning_shares(noise, 4000, 5e-9)
    assert np.mean(shares > 0) == pytest.approx(np.exp(-4.0), abs=0.01)
    assert learning_shares(noise + 1e-4, 4000, 5e-9).min() > 0.99


def test_a_filter_that_does_not_contract_is_refused_with_what_a_period_leaves():
    good = learning_filter(AXIS, None, points=POINTS, sampling_rate_Hz=RATE_Hz)
    assert good.sector < good.contraction < 1.0
    with pytest.raises(DesignError, match=r"does not contract: at 100 Hz.*leave 1\.\d+ of"):
        first_table(AXIS, PLANT, triangle(), parameters=shipped(), gain=2.2)


def test_what_the_axis_cannot_follow_is_refused_with_both_figures():
    with pytest.raises(ParameterFileError, match=r"the reference is from .* to .* within"):
        first_table(AXIS, PLANT, triangle(1.2), parameters=shipped())
    slow = replace(PLANT, slew_V_per_s=100.0)
    with pytest.raises(ParameterFileError, match=r"moves at up to .* at most"):
        first_table(AXIS, slow, triangle(), parameters=None)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"sampling_rate_Hz": 0.5 * RATE_Hz}, r"recorded at 10\.0000 kHz.*played at 20\.0000 kHz"),
        ({"rows": slice(0, 150)}, "150 samples, and a period has 200"),
        ({"late": 60}, "deviates from the period by .* from its row 60"),
        ({"scale": 1e3}, "deviates from the period by"),
    ],
)
def test_a_recording_that_is_not_the_period_is_refused_with_figures(changed, said):
    learned = first()
    moved_m = changed.pop("scale", 1.0) * np.roll(learned.wanted_m, changed.pop("late", 0))
    rows = changed.pop("rows", slice(None))
    given = {"voltage_V": learned.table_V[rows], "displacement_m": moved_m[rows]}
    seen = from_arrays(**{**given, "sampling_rate_Hz": RATE_Hz, **changed})
    with pytest.raises(RecordingError, match=said):
        next_table(learned, AXIS, PLANT, seen, parameters=shipped())


def test_a_table_of_another_reference_model_or_loop_is_refused():
    before, changed_m = first(), triangle()
    same = {"sources": before.sources, "closed_loop": before.closed_loop}
    refuse_changed(before, triangle(), **same)
    changed_m[17] += 2e-9
    with pytest.raises(RecordingError, match=r"by up to 2\.00 nm, at point 17"):
        refuse_changed(before, changed_m, **same)
    with pytest.raises(ParameterFileError, match="learnt of another model"):
        refuse_changed(before, triangle(), **{**same, "sources": {"model": "x"}})
    with pytest.raises(ParameterFileError, match=r"learnt with(out)? a controller"):
        refuse_changed(before, triangle(), **{**same, "closed_loop": not before.closed_loop})
