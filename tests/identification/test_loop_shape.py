"""Loop shape: structure that plays with dead zones cannot represent is fitted and stored."""

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from piezoid.diagnosis.signals import with_displacement, with_extension
from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.extension import Extension, Where
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.identification.extensions.mains_lines import Hum, MainsLines
from piezoid.identification.extensions.periodic_error import PeriodicError, Phase
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.loop_shape import history_of
from piezoid.identification.loop_shape_columns import (
    columns_of,
    piece_rows,
    reference_columns,
    zero_loop_shape,
)
from piezoid.identification.loop_shape_fit import with_loop_shape
from piezoid.identification.model import SCHEMA, AxisModel, Lag
from piezoid.identification.simulation import compare, simulate_recording
from piezoid.identification.store import read_model, write_model
from piezoid.numerics.arrays import Array
from piezoid.operators.wide_hysteresis import coefficients
from piezoid.records.frames import from_arrays
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.truths import ZOO
from tests.laws import LAWS, Law

NOISE_M = 8e-9
RATE_Hz = 400.0
BEGINNING = 250  # samples of the cycle that erases the initial state


def path_through(levels: Array) -> Array:
    runs = [np.linspace(a, b, int(60 * abs(b - a)) + 3)[1:] for a, b in pairwise(levels)]
    return np.concatenate([levels[:1], *runs])


def walk(seed: int) -> Array:
    turns = np.random.default_rng(seed).uniform(-1.0, 1.0, 30)
    return path_through(np.concatenate([[-1.0, 1.0, -1.0], turns]))


SWEEP = path_through(
    np.concatenate([[-1.0], np.linspace(1.0, 0.05, 31) * (-1.0) ** np.arange(31)])
)


def law_of(name: str) -> Law:
    """Return a sum of plays, or a ceramic of the virtual laboratory."""
    if name == "plays":
        return LAWS[name]
    names = [truth.name for truth in ZOO]
    ceramic = ZOO[names.index(name)].draw(np.random.default_rng(5))
    return lambda field: np.add(*ceramic.respond(field, np.zeros(0)))


def recorded(
    law: str,
    field: Array,
    name: str,
    polarity: float = 1.0,
    part: Extension | None = None,
) -> Recording:
    history = np.tile(path_through(np.array([0.0, 1.0, -1.0, 1.0, -1.0])), 2)
    displacement_m = 2e-5 * law_of(law)(np.concatenate([history, field]))[len(history) :]
    if part is not None:
        displacement_m = part.response(displacement_m, Where(recording=name, rate_Hz=RATE_Hz))
    noise_m = NOISE_M * np.random.default_rng(len(field)).standard_normal(len(field))
    return recording_of(5.0 * field, polarity * displacement_m + noise_m, name)


def recording_of(voltage_V: Array, displacement_m: Array, name: str) -> Recording:
    return from_arrays(
        voltage_V=voltage_V,
        displacement_m=displacement_m,
        sampling_rate_Hz=RATE_Hz,
        axis="x",
        name=name,
    )


@cache
def fitted(law: str) -> tuple[tuple[Recording, ...], AxisModel, AxisModel]:
    """Return recordings, the axis of plays alone, and the axis with loop shape."""
    recordings = (recorded(law, SWEEP, "sweep", -1.0), recorded(law, walk(3), "walk", -1.0))
    plays = estimate_axis(recordings, "x", Rig(), orders=((8, 2),))
    return recordings, plays, with_loop_shape(plays, recordings)


def test_a_law_other_than_plays_is_explained_to_the_noise():
    recordings, plays, axis = fitted("dahl")
    assert plays.quality.rms_m > 3.0 * NOISE_M
    assert axis.quality.explained_rms_m < 1.2 * NOISE_M
    assert axis.quality.held_out_rms_m < 2.0 * NOISE_M
    errors_m = [
        (r.displacement_m("x") - simulate_recording(axis, r))[start.first : start.last]
        for r, start in zip(recordings, axis.starts, strict=True)
    ]
    rms_m = np.sqrt(np.mean(np.concatenate(errors_m) ** 2))
    assert rms_m == pytest.approx(axis.quality.rms_m, rel=0.1)
    assert abs(axis.loop_shape.plays_weight) < 0.2  # without the kinks of plays


def test_a_lag_of_several_periods_of_the_drive_is_found_wrong():
    """The error has a minimum in every period of the lag; that without lag is tried as well.

    The chirp ends at rest, and a gap divides the rest.
    """
    chirp = -0.4 + 0.1 * np.sin(2.0 * np.pi * np.arange(2000) * (0.01 + 2e-5 * np.arange(2000)))
    rested = recorded("dahl", np.append(chirp, np.full(600, chirp[-1])), "chirp")
    recordings = (recorded("dahl", SWEEP, "sweep"), replace(rested, breaks=(2200,)))
    plays = estimate_axis(recordings, "x", Rig(), orders=((8, 2),))
    delayed = replace(plays, lag=Lag(kind="delay", time_s=0.1))
    axis = with_loop_shape(delayed, recordings)
    assert axis.lag.time_s < 1e-4
    assert axis.quality.explained_rms_m < 1.2 * NOISE_M


def test_loop_shape_improves_the_prediction_of_a_new_recording():
    _, plays, axis = fitted("dahl")
    unseen = recorded("dahl", walk(4), "unseen", -1.0)
    plays_m, wide_m = (
        float(np.std(compare(model, unseen).error_m[BEGINNING:])) for model in (plays, axis)
    )
    assert wide_m < 0.5 * plays_m


def test_the_inverse_with_loop_shape_follows_a_new_reference():
    _, plays, axis = fitted("dahl")
    phase = np.linspace(0.0, 1.0, 2000)
    approach_m = axis.zero_m + np.linspace(1e-5, 0.0, 200)
    tones_m = 4e-6 * np.sin(10.0 * np.pi * phase) + 3e-6 * np.sin(26.0 * np.pi * phase)
    reference_m = np.concatenate([approach_m, axis.zero_m + tones_m])
    cycle = np.array([0.0, 1.0, -1.0, 1.0, -1.0])
    history = np.tile(path_through(cycle), 2)
    errors_m = []
    for model in (plays, axis):
        voltage_V = model.inverse(reference_m, model.memory_after(5.0 * cycle))
        path = np.concatenate([history, voltage_V / 5.0])
        reached_m = -2e-5 * law_of("dahl")(path)[len(history) :]
        errors_m.append(float(np.std((reached_m - reference_m)[BEGINNING:])))
    assert errors_m[1] < 0.35 * errors_m[0]
    assert errors_m[1] < 5.0 * NOISE_M


def test_beyond_the_recorded_range_the_inverse_stays_close_to_that_of_plays():
    _, plays, axis = fitted("dahl")
    reach_m = 1.05e-5  # of a range of 10 um about the zero
    reference_m = axis.zero_m + reach_m * np.sin(np.linspace(-0.5, 7.5, 1000) * np.pi)
    memory_V = plays.memory_after(5.0 * np.array([1.0, -1.0, 1.0, -1.0]))
    plays_V, voltage_V = (model.inverse(reference_m, memory_V) for model in (plays, axis))
    assert 5.0 < np.abs(voltage_V).max() < 1.05 * np.abs(plays_V).max()


def test_loops_of_three_sizes_predict_a_fourth_size():
    def loops(size: float) -> Array:
        return path_through(np.tile([-1.0, 2.0 * size - 1.0], 4))

    recordings = [recorded("bouc_wen", loops(size), f"{size}.csv") for size in (1.0, 0.6, 0.3)]
    plays = estimate_axis(recordings, "x", Rig(), orders=((4, 1),))
    axis = with_loop_shape(plays, recordings)
    fourth = recorded("bouc_wen", loops(0.8), "0.8.csv")
    assert axis.loop_shape is not None
    assert compare(axis, fourth).rms_m < 1.5 * compare(plays, fourth).rms_m


def test_initial_states_of_recordings_are_fitted_with_loop_shape():
    """A solution that neglected the initial states in the columns left 2.2 times the noise."""
    decay = np.linspace(1.0, 0.1, 20) * (-1.0) ** np.arange(20)
    turns = np.random.default_rng(4).uniform(-1.0, 1.0, 24)
    recordings = []
    for name, reversals, levels in (
        ("decay", [0.0, 1.0, -1.0, 0.5, -0.4], [-0.4, 0.3, -0.6, 0.7, -0.8, 0.9, -1.0, *decay]),
        ("walk", [-1.0, 0.49, -1.0, 0.2], [0.2, -0.3, 0.5, -0.7, 0.8, -0.95, *turns]),
    ):
        history, field = path_through(np.array(reversals)), path_through(np.array(levels))
        displacement_m = (
            2e-5 * law_of("preisach")(np.concatenate([history, field]))[len(history) :]
        )
        displacement_m += NOISE_M * np.random.default_rng(len(field)).standard_normal(len(field))
        recordings.append(recording_of(5.0 * field, displacement_m, name))
    plays = estimate_axis(recordings, "x", Rig(), orders=((4, 1),))
    axis = with_loop_shape(plays, recordings)
    for recording, start in zip(recordings, axis.starts, strict=True):
        error_m = (recording.displacement_m("x") - simulate_recording(axis, recording))[
            start.first : start.last
        ]
        assert np.sqrt(np.mean(error_m[: len(error_m) // 5] ** 2)) < 1.5 * NOISE_M


def test_a_drifting_zero_in_a_held_out_block_is_not_a_model_error():
    """Each of 25 knots of the zero lies in one block; other blocks do not determine it."""
    recordings, plays, _ = fitted("dahl")
    starts = [replace(start, zero_m=np.full(25, start.zero_m.mean())) for start in plays.starts]
    shaped = with_loop_shape(replace(plays, starts=tuple(starts)), recordings)
    assert shaped.quality.explained_rms_m < 1.2 * NOISE_M
    assert shaped.quality.held_out_rms_m < 2.0 * NOISE_M


def test_many_recordings_use_fewer_drive_histories_each(monkeypatch):
    """The limit is that of ten recordings; here two exceed it."""
    recordings, plays, unlimited = fitted("dahl")
    monkeypatch.setattr("piezoid.identification.loop_shape_columns.MAX_HISTORIES", 6)
    axis = with_loop_shape(plays, recordings)
    for start, reference in zip(axis.starts, unlimited.starts, strict=True):
        assert 0 < np.count_nonzero(start.history_weight) <= 3
        assert np.count_nonzero(reference.history_weight) > 3
    assert axis.quality.rms_m < plays.quality.rms_m


def test_loop_shape_does_not_worsen_the_prediction_of_plays():
    _, plays, axis = fitted("plays")
    assert axis.quality.held_out_rms_m <= plays.quality.held_out_rms_m
    assert axis.quality.explained_rms_m < 1.5 * NOISE_M


def test_a_periodic_error_is_fitted_together_with_loop_shape():
    """Plays alone distort its parameters.

    One recording has a different zero: the same error at another phase of the reading.
    """
    recordings, plays, _ = fitted("dahl")
    phases = (Phase(recording=recordings[1].name, angle=2.6),)
    expected = PeriodicError(wavelength_m=1.5e-6, cosine_m=(2e-8,), sine_m=(3e-8,), phases=phases)
    readings = tuple(with_extension(recording, expected) for recording in recordings)
    unknown = tuple(Phase(recording=r.name, angle=0.0) for r in recordings[1:])
    initial = replace(
        expected, wavelength_m=1.502e-6, cosine_m=(1e-8,), sine_m=(2e-8,), phases=unknown
    )
    axis = with_loop_shape(replace(plays, extensions=(initial,)), readings)
    (error,) = axis.extensions
    assert error.wavelength_m == pytest.approx(expected.wavelength_m, rel=1e-3)
    assert error.amplitude_m == pytest.approx(expected.amplitude_m, rel=0.05)
    assert axis.quality.explained_rms_m < 1.3 * NOISE_M


def test_a_steep_periodic_error_and_unknown_histories_are_fitted_together():
    """Linearised solutions overshot and left 75 times the noise."""
    count = np.arange(0, 2000, 2)
    fields = {
        "loops": 0.9 * np.sin(2 * np.pi * count / 700) * np.linspace(1.0, 0.7, 1000),
        "small": 0.04 * np.sin(count / np.linspace(40.0, 4.0, 1000)) - 0.3,
        "noise": 0.4 * np.sin(count / 31.0) * np.sin(count / 83.0),
    }
    recordings = [recorded("dahl", field, name) for name, field in fields.items()]
    expected = PeriodicError(
        wavelength_m=7e-7,
        cosine_m=(6e-8, 1e-8),
        sine_m=(8e-8, 1e-8),
        phases=tuple(Phase(recording=name, angle=0.5) for name in ("small", "noise")),
    )
    readings = tuple(with_extension(recording, expected) for recording in recordings)
    plays = estimate_axis(readings, "x", Rig(), orders=((4, 1),))
    initial = replace(expected, wavelength_m=7.007e-7, cosine_m=(5e-8, 0.0), sine_m=(7e-8, 0.0))
    shaped = with_loop_shape(replace(plays, extensions=(initial,)), readings)
    assert shaped.loop_shape is not None
    assert shaped.quality.explained_rms_m < 2.0 * NOISE_M


def test_loop_shape_is_fitted_with_a_mode():
    """A delay instead of the mode leaves 1 % of fast motion: below hysteresis, above noise."""
    mode = LinearMode(frequency_Hz=60.0, quality=20.0)
    fast = 0.6 * np.sin(np.arange(1500) / 15.0)
    fields = {"sweep": SWEEP[::2], "quick": fast}
    static = tuple(recorded("dahl", field, name) for name, field in fields.items())
    ringing = tuple(recorded("dahl", field, name, 1.0, mode) for name, field in fields.items())
    plays = estimate_axis(static, "x", Rig(), orders=((4, 1),))
    shaped = with_loop_shape(replace(plays, extensions=(mode,)), ringing)
    assert shaped.loop_shape is not None
    assert shaped.quality.explained_rms_m < 1.5 * NOISE_M


def test_the_columns_of_the_class_contain_the_creep_of_its_motion():
    """Without it no step is confirmed by the simulation if the shares of creep are large."""
    creep = CreepLadder(time_s=(0.05, 0.5, 5.0), share=(0.03, 0.14, 0.02))
    recordings, plays, _ = fitted("dahl")
    axis = replace(plays, extensions=(creep,))
    pieces = piece_rows(axis, recordings)
    columns = columns_of(axis, pieces, reference_columns(axis))
    weight = np.random.default_rng(1).standard_normal(len(columns.scale) - 1)
    density_m, smooth_m = coefficients(1e-6 * weight)
    shape = replace(zero_loop_shape(axis), density_m=density_m, smooth_m=smooth_m)
    motions_m = []
    for piece in pieces:
        history = history_of(axis.hysteresis, piece.start.memory_V, shape)
        static_m = shape.response(piece.drive_V, history)
        motion_m = axis.forward.linear_response(static_m, piece.where)
        motions_m.append(motion_m[piece.rows])
    simulated_m = np.concatenate(motions_m)
    of_columns_m = (columns.values * columns.scale)[:, :-1] @ (1e-6 * weight)
    assert np.std(of_columns_m - simulated_m) < 2e-3 * np.std(simulated_m)


def test_a_hum_with_harmonics_is_fitted_to_a_subset_of_rows(monkeypatch):
    monkeypatch.setattr("piezoid.identification.loop_shape_columns.MAX_ROWS", 3000)
    field = np.interp(np.linspace(0.0, len(SWEEP) - 1.0, 4000), np.arange(len(SWEEP)), SWEEP)
    silent = recorded("dahl", field, "sweep")
    phase = 2.0 * np.pi * 50.0 * np.arange(len(field)) / silent.sampling_rate_Hz
    hum_m = 4e-8 * np.cos(phase + 0.3) + 2e-8 * np.cos(3.0 * phase)
    humming = with_displacement(silent, silent.displacement_m("x") + hum_m)
    plays = estimate_axis((humming,), "x", Rig(), orders=((4, 1),))
    zeros = (0.0, 0.0)
    hum = Hum(recording="sweep", first=0, harmonic=(1, 3), cosine_m=zeros, sine_m=zeros)
    lines = MainsLines(frequency_Hz=50.0, hums=(hum,))
    shaped = with_loop_shape(replace(plays, extensions=(lines,)), (humming,))
    assert shaped.loop_shape is not None
    error_m = humming.displacement_m("x") - simulate_recording(shaped, humming)
    assert np.sqrt(np.nanmean(error_m**2)) < 1.2 * NOISE_M


@pytest.mark.parametrize(("noise_factor", "least", "most"), [(1.0, 0.8, 1.2), (30.0, 0.0, 0.5)])
def test_a_step_of_the_zero_remains_in_the_residual_above_the_noise(noise_factor, least, most):
    step_m = 5e-7
    cycles = np.concatenate([np.ones(4), np.linspace(1.0, 0.3, 8)])
    field = path_through(np.append(np.repeat(cycles, 2) * np.tile([-1.0, 1.0], 12), -1.0))
    middle = len(field) // 2 + 40
    displacement_m = 2e-5 * law_of("dahl")(np.concatenate([field, field]))[len(field) :]
    displacement_m[middle:] += step_m
    noise_m = 6e-8 * np.random.default_rng(1).standard_normal(len(field))
    recording = recording_of(5.0 * field, displacement_m + noise_m, "jump")
    assert len(recording.pieces) == 1
    plays = estimate_axis([recording], "x", Rig(), orders=((4, 1),))
    noise_bound_m = noise_factor * plays.quality.noise_rms_m
    plays = replace(plays, quality=replace(plays.quality, noise_rms_m=noise_bound_m))
    axis = with_loop_shape(plays, [recording])
    assert axis.loop_shape is not None
    error_m = recording.displacement_m("x") - simulate_recording(axis, recording)
    jump_m = np.mean(error_m[middle : middle + 300]) - np.mean(error_m[middle - 300 : middle])
    assert least < jump_m / step_m < most  # the loop shape contains the rest


def test_the_in_sample_error_decides_for_a_single_loop():
    ramp = np.linspace(-1.0, 1.0, 900)
    loop = recorded("coleman_hodgdon", np.concatenate([ramp, ramp[-2::-1]]), "loop")
    plays = estimate_axis([loop], "x", Rig(), orders=((4, 1),))
    axis = with_loop_shape(plays, [loop])
    assert axis.loop_shape is not None
    assert axis.quality.rms_m < 1.05 * NOISE_M < plays.quality.rms_m
    assert not axis.quality.is_tested


def test_loop_shape_survives_its_file_bit_by_bit():
    recordings, _, axis = fitted("dahl")
    stage = ActuatorModel(stage="s", axes={"x": axis}, sources={}, lab=None, tunnelling=None)
    restored = read_model(write_model(stage)).axes["x"]
    assert np.array_equal(
        simulate_recording(restored, recordings[0]), simulate_recording(axis, recordings[0])
    )
    assert restored.quality == axis.quality


def test_loop_shape_can_be_removed_and_is_not_fitted_twice():
    recordings, plays, axis = fitted("dahl")
    restored = axis.without_loop_shape()
    assert restored.loop_shape is None
    assert restored.quality == plays.quality
    np.testing.assert_array_equal(
        simulate_recording(restored, recordings[1]), simulate_recording(plays, recordings[1])
    )
    with pytest.raises(ValueError, match="has loop shape already"):
        with_loop_shape(axis, recordings)


def test_a_model_with_coefficients_of_another_class_is_refused():
    _, _, axis = fitted("dahl")
    stage = ActuatorModel(stage="s", axes={"x": axis}, sources={}, lab=None, tunnelling=None)
    record = json.loads(write_model(stage))
    record["axes"]["x"]["loop_shape"]["smooth_m"].pop()
    content = {key: value for key, value in record.items() if key not in ("schema", "digest")}
    with pytest.raises(ParameterFileError, match="coefficients"):
        read_model(seal(SCHEMA, content))
