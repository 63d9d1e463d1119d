"""Clock slips are found, sized, repaired and distinguished from delays of the stage."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from benchmarks.zoo.score import read_campaign
from benchmarks.zoo.stages import draw_stage, stage
from piezoid.diagnosis.candidate import Outcome, size_of
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import timestamp_fault
from piezoid.diagnosis.effects.timestamp_fault import find_equal_slips, slip_evidence
from piezoid.diagnosis.residual_view import with_tracks
from piezoid.diagnosis.sample_slips import (
    MIN_ROWS,
    delay_like_null,
    instant_error,
    max_slip,
    strongest_slips,
)
from piezoid.diagnosis.selection import repair_faults, search, search_all, with_ingest_faults
from piezoid.identification.extensions.extension import Where
from piezoid.identification.extensions.linear_mode import LinearMode
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL
from piezoid.records.recording import Channel, Quantity
from piezoid.statement import finding
from piezoid_datasets.virtual_lab.truths import ZOO

from .bench import single_axis_recording, thinned, view_of_recordings, with_fewer_rows
from .play_stage import (
    NOISE_m,
    STROKE_m,
    clean,
    healthy,
    is_within_interval,
    recording,
    stroke_fraction,
    view_with,
    with_slip,
)


@pytest.mark.parametrize(("kind", "samples"), [("walk", -3), ("waves", 60)])
def test_a_slip_is_found_sized_and_repaired(kind, samples):
    view = view_with(**{kind: with_slip(clean(kind)[2], 4100, samples)})
    fault = timestamp_fault.EFFECT.fault.find(view)
    assert is_within_interval(fault, samples)
    assert fault.p_value < 0.01
    name, _, since_s, *_ = fault.locations[0].split()
    assert name == kind
    assert float(since_s) == pytest.approx(4100 / clean(kind)[0], rel=0.05)
    repaired = with_tracks(view, fault.tracks)
    assert repaired.rms < min(1.6 * healthy().rms, 0.9 * view.rms)
    assert timestamp_fault.EFFECT.fault.find(repaired) is None


def test_two_recordings_with_different_slips_are_repaired():
    view = view_with(
        sweep=with_slip(clean("sweep")[2], 3500, 5), walk=with_slip(clean("walk")[2], 5000, -4)
    )
    fault = timestamp_fault.EFFECT.fault.find(view)
    repaired = with_tracks(view, fault.tracks)
    assert repaired.rms < 1.3 * healthy().rms
    assert fault.value in (5, -4)


def test_a_delay_of_a_whole_recording_is_not_a_slip():
    view = view_with(sweep=with_slip(clean("sweep")[2], 0, 4))
    assert timestamp_fault.EFFECT.fault.find(view) is None


def test_a_delay_of_fast_motion_only_is_not_a_slip():
    # Slow triangles first, fast ones after: a lag of fast motion begins at one instant.
    time_s = np.arange(9000) / 4000.0
    phase = np.where(time_s < 1.25, 1.6 * time_s, 2.0 + 20.0 * (time_s - 1.25))
    field = 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (phase - 0.25)))
    displacement_m = STROKE_m * stroke_fraction(field)
    delayed_m = np.where(time_s < 1.25, displacement_m, with_slip(displacement_m, 5000, 1))
    delayed_m = delayed_m + np.random.default_rng(8).normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk"), recording("waves", delayed_m, field)]
    view = view_of_recordings(recordings)
    null = delay_like_null(view)
    for slip in strongest_slips(view, null):
        evidence = slip_evidence(view, null, replace(slip, samples=round(slip.samples) or 1))
        assert evidence is None or not evidence.is_significant


@pytest.mark.parametrize(("kind", "ratio"), [("waves", 1.5), ("sweep", 0.8)])
def test_a_slip_is_found_above_the_detection_bound_and_not_below_it(kind, ratio):
    limit_m = timestamp_fault.EFFECT.fault.bound(healthy()) * 2.0 * healthy().half_stroke_m
    changes_m = [with_slip(clean(kind)[2], 4100, n) - clean(kind)[2] for n in range(60)]
    rms_m = np.array([np.sqrt(np.mean(change_m**2)) for change_m in changes_m])
    # the next larger slip above the bound, the next smaller slip below it
    samples = int(np.argmax(rms_m > ratio * limit_m)) - (ratio < 1.0)
    assert samples > 0
    view = view_with(**{kind: with_slip(clean(kind)[2], 4100, samples)})
    fault = timestamp_fault.EFFECT.fault.find(view)
    assert is_within_interval(fault, samples) if ratio > 1.0 else fault is None


@pytest.mark.parametrize("samples", [-60, 60])
def test_a_slip_is_located_and_sized_before_its_refinement(samples):
    view = view_with(walk=with_slip(clean("walk")[2], 4100, samples))
    slip = strongest_slips(view, delay_like_null(view))[0]
    assert slip.track == 1
    assert abs(slip.instant - 4100) <= instant_error(9000)
    assert slip.samples == pytest.approx(samples, rel=0.1)


@pytest.mark.parametrize("later", [0, -20], ids=["alone", "before_an_opposite_slip"])
def test_a_slip_of_known_length_is_located_by_the_error_alone(later):
    view = view_with(sweep=with_slip(with_slip(clean("sweep")[2], 2500, 12), 6500, later))
    fault = find_equal_slips(view, partial(with_tracks, view), 12)
    name, _, since_s, *_ = fault.locations[0].split()
    assert (name, fault.value) == ("sweep", 12)
    assert float(since_s) == pytest.approx(2500 / clean("sweep")[0], rel=0.01)
    assert fault.p_value < 1e-6
    assert with_tracks(view, fault.tracks).rms < 0.9 * view.rms


def test_no_slip_of_known_length_is_found_in_a_healthy_stage():
    assert find_equal_slips(healthy(), partial(with_tracks, healthy()), 12) is None


@pytest.mark.parametrize(("rows", "is_searched"), [(MIN_ROWS, True), (MIN_ROWS - 1, False)])
def test_a_slip_is_searched_in_recordings_of_enough_rows(rows, is_searched):
    view = view_with(waves=with_slip(clean("waves")[2], 4100, 60))
    *others, track = view.tracks
    selected = np.linspace(0, len(track.rows) - 1, rows).astype(int)
    short = replace(track, rows=track.rows[selected], block=track.block[selected])
    view = with_tracks(view, [*others, short])
    slips = strongest_slips(view, delay_like_null(view))
    assert (len(others) in {slip.track for slip in slips}) is is_searched


def test_faults_of_time_stamps_add_to_the_slip_in_samples():
    sweep = recording("sweep")
    statements = (
        finding(quantity="gap", text="", value=40.0, unit="samples"),
        finding(quantity="duplicate_time", text="", value=3.0, unit="samples"),
        finding(quantity="jitter", text=""),
    )
    slip = Fault(tracks=healthy().tracks, value=-5.0, spread=0.4, p_value=0.001)
    outcome = Outcome(
        first=healthy(),
        clean=healthy(),
        final=healthy(),
        faults={"timestamp_fault": slip},
        causes=(),
        confounded={},
        score_tests={},
    )
    assert with_ingest_faults(outcome, [sweep], STROKE_m).faults == outcome.faults
    recordings = [sweep, replace(sweep, name="b", statements=statements)]
    fault = with_ingest_faults(outcome, recordings, STROKE_m).faults["timestamp_fault"]
    assert fault.value == 48.0
    assert fault.p_value < 1e-6
    without_slip = with_ingest_faults(replace(outcome, faults={}), recordings, STROKE_m)
    assert without_slip.faults["timestamp_fault"].value == 43.0


@pytest.mark.parametrize("is_driven", [True, False], ids=["driven", "constant"])
def test_a_slip_that_another_drive_explains_as_well_is_not_a_slip(is_driven):
    reading_m = clean("walk")[2]
    delayed_m = with_slip(reading_m, 4000, 10)
    other_drive = Channel(
        quantity=Quantity.VOLTAGE,
        axis="y",
        values=(delayed_m - reading_m) / STROKE_m if is_driven else np.zeros(len(delayed_m)),
        label="other drive",
    )
    walk = recording("walk", delayed_m)
    coupled = replace(walk, channels=(*walk.channels, other_drive))
    view = view_of_recordings([recording("sweep"), coupled, recording("waves")])
    fault = timestamp_fault.EFFECT.fault.find(view)
    assert fault is None if is_driven else is_within_interval(fault, 10)


def test_slips_of_a_nearly_constant_recording_stay_within_the_limit():
    rng = np.random.default_rng(9)
    field = 0.3 + 0.01 * np.sin(2 * np.pi * 1.3 * np.arange(9000) / 9000)
    random_walk = 0.05 * np.cumsum(rng.normal(size=9000)) / np.sqrt(9000)
    reading_m = STROKE_m * (stroke_fraction(field) + random_walk) + rng.normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk"), recording("waves", reading_m, field)]
    view = view_of_recordings(recordings)
    slips = strongest_slips(view, delay_like_null(view))
    assert slips
    for slip in slips:
        assert abs(slip.samples) <= max_slip(len(view.tracks[slip.track].drive))
    assert timestamp_fault.EFFECT.fault.find(view) is None


@pytest.mark.slow
def test_the_residual_of_a_healthy_stage_is_not_a_slip():
    """Repairing the apparent slip of other_axis.csv raises the held-out error."""
    recordings, lab = read_campaign(
        draw_stage(stage("preisach_lorentzian", "healthy", 0, 990_000))
    )
    selected = [r for r in recordings if r.name in ("sweep.csv", "check.csv", "other_axis.csv")]
    assert len(selected) == 3
    assert repair_faults(view_on(selected, axis="x", lab=lab), SERIAL)[1] == {}


@pytest.mark.slow
def test_a_slip_in_fast_motion_does_not_add_a_delay():
    """Slow motion does not show the slip; for all other effects the fast half is delayed."""
    recordings, lab = read_campaign(draw_stage(stage("duhem", "single", 0, 2_100_000)))
    selected = [r for r in recordings if r.name in ("sweep.csv", "chirp.csv")]
    outcome = search(with_fewer_rows(view_on(selected, axis="x", lab=lab), 12))
    assert (set(outcome.faults), outcome.causes) == ({"timestamp_fault"}, ())


@pytest.mark.slow
@pytest.mark.usefixtures("few_rows")
def test_a_slip_before_faster_motion_is_not_a_delay():
    """No speed occurs on both sides of the slip: only the error separates it from a delay."""
    campaign = draw_stage(stage("duhem", "single", 0, 20_263_730), settled=True)
    recordings, lab = read_campaign(campaign)
    selected = [r for r in recordings if r.name != "staircase.csv"]
    outcome = search(with_fewer_rows(view_on(selected, axis="x", lab=lab), 3))
    assert outcome.causes == ()
    assert outcome.faults["timestamp_fault"].value == 2


@pytest.mark.slow
@pytest.mark.usefixtures("few_rows")
def test_a_slip_is_found_in_the_presence_of_a_gain_change():
    reading_m = np.array(clean("waves")[2])
    reading_m[2000:] *= 1.05
    slipped = recording("waves", with_slip(reading_m, 6100, 12))
    outcome = search(view_of_recordings(thinned([recording("sweep"), slipped], 3)))
    assert set(outcome.faults) == {"timestamp_fault"}
    assert is_within_interval(outcome.faults["timestamp_fault"], 4)
    (cause,) = outcome.causes
    assert cause.effect.name == "gain_change"
    low, high = size_of(cause).ci95
    assert low < 5.0 < high
    assert outcome.final.rms < 1.5 * outcome.final.noise


def course_of(levels: Sequence[float], samples: int) -> Array:
    """Return a drive through levels at one speed."""
    travel = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(levels)))])
    return np.interp(np.linspace(0.0, travel[-1], samples), travel, levels)


def test_a_resonance_beside_unknown_initial_states_is_no_slip():
    """Beside wrong initial states the phase of a mode at a rising frequency resembles slips."""
    mode = LinearMode(frequency_Hz=723.0, quality=5.3, participation=0.58)
    time_s = np.arange(11_000) / 10_000.0
    chirp = -0.13 + 0.19 * np.sin(2.0 * np.pi * (2.0 + 358.0 * time_s) * time_s)
    turns = np.random.default_rng(117).uniform(-1.0, 1.0, 30)
    loops = course_of([-1.0, 1.0, -1.0, *turns], 6000)
    triangle = course_of([0.0, 0.8, -0.8, 0.8, 0.0], 3000)
    drives = {
        "loops": (500.0, loops, (-0.14, 0.22, 0.47, -0.97, -0.49)),
        "chirp": (10_000.0, chirp, (0.0, 0.21, -0.83, 1.0, 0.66)),
        "triangle": (2000.0, triangle, (0.0, -0.93, 0.14, 0.22)),
    }
    ceramic = next(truth for truth in ZOO if truth.name == "preisach_lorentzian").draw(
        np.random.default_rng(5)
    )
    rng, recordings = np.random.default_rng(17), []
    for name, (rate_Hz, field, turns_before) in drives.items():
        history = course_of([*turns_before, field[0]], 600)
        response = np.add(*ceramic.respond(np.concatenate([history, field]), np.zeros(0)))
        where = Where(recording=name, rate_Hz=rate_Hz)
        moved_m = mode.response(3e-6 * response[len(history) :], where)
        reading_m = moved_m + 2e-9 * rng.standard_normal(len(field))
        recordings.append(single_axis_recording(name, rate_Hz, 5.0 * field, reading_m))
    outcome = search_all(with_fewer_rows(view_of_recordings(recordings), 3), SERIAL).outcome
    assert "timestamp_fault" not in outcome.faults
    assert "resonance" in {cause.effect.name for cause in outcome.causes}
    assert outcome.final.rms < 1.2 * outcome.final.noise
