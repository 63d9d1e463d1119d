"""Slips of a clock are found, sized, undone, and told from delays of the stage."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.zoo.score import read_campaign as recorded
from benchmarks.zoo.stages import draw_stage as drawn
from benchmarks.zoo.stages import stage
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effect import Fault
from piezoid.diagnosis.effects import timestamp_fault
from piezoid.diagnosis.effects.timestamp_fault import slip_evidence
from piezoid.diagnosis.residual_view import with_tracks
from piezoid.diagnosis.sample_slips import delay_like_null, max_slip, strongest_slips
from piezoid.diagnosis.selection import Outcome, search, with_ingest_faults
from piezoid.records.lab import Lab
from piezoid.records.recording import Channel, Quantity
from piezoid.statement import finding

from .play_stage import (
    NOISE_m,
    STROKE_m,
    clean,
    healthy,
    moved,
    recording,
    slipped,
    view_with,
    within,
)


@pytest.mark.parametrize(("kind", "samples"), [("sweep", 4), ("walk", -3), ("waves", 60)])
def test_a_slip_is_found_sized_and_undone(kind, samples):
    view = view_with(**{kind: slipped(clean(kind)[2], 4100, samples)})
    fault = timestamp_fault.EFFECT.fault.find(view)
    assert fault is not None
    assert within(fault, samples)
    assert fault.p_value < 0.01
    name, _, since_s, *_ = fault.locations[0].split()
    assert name == kind
    assert float(since_s) == pytest.approx(4100 / clean(kind)[0], rel=0.05)
    again = with_tracks(view, fault.tracks)
    assert again.rms < min(1.6 * healthy().rms, 0.9 * view.rms)
    assert timestamp_fault.EFFECT.fault.find(again) is None


def test_two_recordings_may_slip_each_by_its_own():
    view = view_with(
        sweep=slipped(clean("sweep")[2], 3500, 5), walk=slipped(clean("walk")[2], 5000, -4)
    )
    fault = timestamp_fault.EFFECT.fault.find(view)
    again = with_tracks(view, fault.tracks)
    assert again.rms < 1.3 * healthy().rms
    assert fault.value in (5, -4)


def test_a_delay_of_all_of_a_recording_is_no_slip():
    view = view_with(sweep=slipped(clean("sweep")[2], 0, 4))
    assert timestamp_fault.EFFECT.fault.find(view) is None


def test_a_delay_that_only_fast_stretches_have_is_no_slip():
    # slow triangles first, fast ones after: a lag of the fast ones begins at one instant
    rate_Hz, field = 4000.0, np.empty(9000)
    time_s = np.arange(9000) / rate_Hz
    phase = np.where(time_s < 1.25, 1.6 * time_s, 2.0 + 20.0 * (time_s - 1.25))
    field = 2 / np.pi * np.arcsin(np.sin(2 * np.pi * (phase - 0.25)))
    whole_m = STROKE_m * moved(field)
    late_m = np.where(time_s < 1.25, whole_m, slipped(whole_m, 5000, 1))
    late_m = late_m + np.random.default_rng(8).normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk"), recording("waves", late_m, field)]
    view = view_on(recordings, axis="x", lab=Lab())
    null = delay_like_null(view)
    for slip in strongest_slips(view, null):
        judged = slip_evidence(view, null, replace(slip, samples=round(slip.samples) or 1))
        assert judged is None or not judged.is_significant


def test_a_slip_well_above_one_that_could_hide_is_found():
    share = timestamp_fault.EFFECT.fault.bound(healthy())
    late_m = [slipped(clean("waves")[2], 4100, n) - clean("waves")[2] for n in range(1, 60)]
    rms = np.array([np.sqrt(np.mean(change_m**2)) for change_m in late_m])
    samples = 1 + int(np.argmax(rms > 1.5 * share * 2.0 * healthy().half_stroke_m))
    view = view_with(waves=slipped(clean("waves")[2], 4100, samples))
    assert within(timestamp_fault.EFFECT.fault.find(view), samples)


def test_what_the_stamps_tell_is_a_timestamp_fault_of_so_many_samples():
    whole = recording("sweep")
    statements = (
        finding(quantity="gap", text="", value=40.0, unit="samples"),
        finding(quantity="duplicate_time", text="", value=3.0, unit="samples"),
        finding(quantity="jitter", text=""),
    )
    slip = Fault(tracks=healthy().tracks, value=-5.0, spread=0.4, p_value=0.001)
    found = Outcome(
        first=healthy(),
        clean=healthy(),
        final=healthy(),
        faults={"timestamp_fault": slip},
        causes=(),
        confounded={},
        score_tests={},
    )
    assert with_ingest_faults(found, [whole], STROKE_m).faults == found.faults
    told = [whole, replace(whole, name="b", statements=statements)]
    fault = with_ingest_faults(found, told, STROKE_m).faults["timestamp_fault"]
    assert fault.value == 48.0
    assert fault.p_value < 1e-6
    alone = with_ingest_faults(replace(found, faults={}), told, STROKE_m)
    assert alone.faults["timestamp_fault"].value == 43.0


@pytest.mark.parametrize("is_driven", [True, False], ids=["driven so", "at rest"])
def test_what_the_drive_of_another_axis_explains_as_well_is_no_slip(is_driven) -> None:
    reading_m = clean("walk")[2]
    late_m = slipped(reading_m, 4000, 10)
    other = Channel(
        quantity=Quantity.VOLTAGE,
        axis="y",
        values=(late_m - reading_m) / STROKE_m if is_driven else np.zeros(len(late_m)),
        label="other drive",
    )
    walk = recording("walk", late_m)
    coupled = replace(walk, channels=(*walk.channels, other))
    view = view_on([recording("sweep"), coupled, recording("waves")], axis="x", lab=Lab())
    fault = timestamp_fault.EFFECT.fault.find(view)
    assert fault is None if is_driven else within(fault, 10)


@pytest.mark.parametrize("seed", [2, 9])
def test_a_recording_that_hardly_moves_promises_no_slip_longer_than_may_be(seed) -> None:
    chance = np.random.default_rng(seed)
    field = 0.3 + 0.01 * np.sin(2 * np.pi * 1.3 * np.arange(9000) / 9000)
    wandered = 0.05 * np.cumsum(chance.normal(size=9000)) / np.sqrt(9000)
    reading_m = STROKE_m * (moved(field) + wandered) + chance.normal(0.0, NOISE_m, 9000)
    recordings = [recording("sweep"), recording("walk"), recording("waves", reading_m, field)]
    view = view_on(recordings, axis="x", lab=Lab())
    slips = strongest_slips(view, delay_like_null(view))
    assert slips
    for slip in slips:
        assert abs(slip.samples) <= max_slip(len(view.tracks[slip.track].drive))
    assert timestamp_fault.EFFECT.fault.find(view) is None


@pytest.mark.slow
def test_what_a_law_leaves_of_a_healthy_stage_is_no_slip_of_its_clock() -> None:
    """Undoing the slip that readings seem to show in other_axis.csv raises the held-out error."""
    recordings, lab = recorded(drawn(stage("preisach_lorentzian", "healthy", 0, 990_000)))
    some = [one for one in recordings if one.name in ("sweep.csv", "check.csv", "other_axis.csv")]
    assert len(some) == 3
    found = search(view_on(some, axis="x", lab=lab))
    assert (found.faults, found.causes) == ({}, ())


@pytest.mark.slow
def test_a_clock_that_slips_in_a_fast_stretch_has_no_delay_beside_it() -> None:
    """Slow stretches tell nothing of it: to all others the fast half of a sweep comes late."""
    recordings, lab = recorded(drawn(stage("duhem", "single", 0, 2_100_000)))
    some = [one for one in recordings if one.name in ("sweep.csv", "chirp.csv")]
    found = search(view_on(some, axis="x", lab=lab))
    assert (set(found.faults), found.causes) == ({"timestamp_fault"}, ())


@pytest.mark.slow
def test_slips_that_other_effects_hide_are_found_beside_them() -> None:
    """The first search for slips sees a gain change and a mode; the chirp has no equal speeds."""
    recordings, lab = recorded(drawn(stage("coleman_hodgdon", "triple", 0, 7_400_000)))
    some = [one for one in recordings if one.name != "check.csv"]
    found = search(view_on(some, axis="x", lab=lab))
    assert set(found.faults) == {"timestamp_fault"}
    names = {cause.effect.name for cause in found.causes}
    assert {"gain_change", "resonance"} <= names <= {"gain_change", "resonance", "initial_state"}
    assert found.final.rms < 5.0 * found.final.noise
