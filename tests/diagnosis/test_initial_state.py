"""What a laboratory always does before it records leaves no unknown memory; neglect does."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from piezoid.diagnosis.candidate import Candidate, structural_candidate
from piezoid.diagnosis.drive_history import (
    CHUNK,
    DELIBERATE,
    History,
    memory_after,
    shared_hypotheses,
    states_along,
)
from piezoid.diagnosis.effects import initial_state
from piezoid.diagnosis.initial_state_search import (
    OTHER_INITIAL_STATES,
    is_shared_state_as_good,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.nuisance import MAX_KEPT, NuisanceClass
from piezoid.diagnosis.nuisance_columns import (
    SHARED,
    THRESHOLD,
    write_shared_columns,
)
from piezoid.diagnosis.residual_view import View, with_free_memory, with_reversals
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import repair_faults
from piezoid.diagnosis.signals import with_displacement
from piezoid.identification.fit import fit
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL
from piezoid.operators.play import play_columns
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, recorded_zoo_stage, thinned, view_of_recordings
from .play_stage import drive
from .played import (
    NOISE,
    WIDTH,
    HALF_STROKE_m,
    at_rest,
    cycled,
    cycled_the_other_way,
    forgotten,
    moved,
    recorded_as,
    recordings_after,
    view_after,
)


def structure_of(view: View) -> Candidate:
    """Judge the memory of recordings as a search does in which nothing else is found."""
    own = with_individual_initial_states(view, with_shared_initial_state(view))
    final = with_free_memory(own) if own.rms < OTHER_INITIAL_STATES * view.rms else view
    judgement = structural_candidate(initial_state.EFFECT, final)
    assert judgement is not None
    return judgement[1]


@pytest.mark.parametrize(
    "before",
    [
        (cycled,) * 3,
        (at_rest,) * 3,
        (cycled_the_other_way,) * 3,
        (cycled_the_other_way, None, None),
        (at_rest, None, None),
    ],
    ids=["cycled", "at rest", "the other way", "one after another", "from rest on"],
)
def test_what_a_laboratory_always_does_before_it_records_is_no_unknown_memory(before):
    view = view_after(*before)
    assert not structure_of(view).is_significant
    if before[0] is not cycled:
        # though the memory that is taken for granted at first is none of it
        assert (
            with_individual_initial_states(view, with_shared_initial_state(view)).rms
            < 0.6 * view.rms
        )


def test_one_recording_that_came_from_elsewhere_has_a_memory_that_nobody_recorded():
    structure = structure_of(view_after(cycled, forgotten, cycled))
    assert structure.is_significant
    assert structure.cv.gain > 2.0 * initial_state.EFFECT.minimum_gain


def test_a_ceramic_that_was_never_driven_so_far_is_poled_once_and_was_not_demagnetised():
    campaign = draw_campaign(104133, truth="preisach", effects={"initial_state": 2.5})
    view = view_of_recordings(*recorded(campaign))
    shared = with_shared_initial_state(view)
    own = with_individual_initial_states(view, shared)
    assert own.rms < 0.85 * shared.rms
    assert not is_shared_state_as_good(shared, own, view)


@pytest.mark.slow
@pytest.mark.usefixtures("one_order")
def test_an_initial_state_that_decays_is_no_step_of_the_zero():
    """A step at the first maximum of the drive left 6.8 times the noise."""
    recordings, lab, noise_rms_m = recorded_zoo_stage("preisach", "quarter", 48522301)
    sweep = [recording for recording in recordings if recording.name == "sweep.csv"]
    model = fit(thinned(sweep, 4), lab=lab)["x"]
    assert model.quality.rms_m < 1.5 * noise_rms_m


HABITS = DELIBERATE + 2  # what a laboratory does on purpose, with the two that end at 0 V
ZERO_VOLTS = -1.3  # in half ranges from the middle of the drive
SELDOM = 6  # samples of a drive for one that is recorded


def left_by(way: Array, memory: Array) -> Array:
    return play_columns(way, THRESHOLD, memory)[1]


def after_turns(kind: str, turns: Sequence[float], part: float) -> Recording:
    """Record a part of a drive with a stage of plays and friction that turned there before."""
    rate_Hz, whole = drive(kind)
    field = part * whole[::SELDOM]
    ways = pairwise([0.0, *turns, float(field[0])])
    before = [np.linspace(here, there, 400)[:-1] for here, there in ways]
    way = np.concatenate([*before, field])
    response, _ = moved(way, np.zeros(len(WIDTH)))
    rub = np.zeros(len(way))
    for i, step in enumerate(np.diff(way), start=1):
        rub[i] = rub[i - 1] + step - 2.0 * abs(step) * rub[i - 1]
    response = (response + rub)[-len(field) :]
    noise = np.random.default_rng(len(kind)).normal(0.0, NOISE * np.ptp(response), len(field))
    return recorded_as(kind, rate_Hz / SELDOM, field, HALF_STROKE_m * (response + noise))


@pytest.mark.parametrize(
    ("last", "near"), [((-1.0, 1.0), 1.15), ((0.0,), 1.8)], ids=["cycled", "switched on"]
)
def test_what_a_stage_with_friction_remembers_is_found_though_drives_hardly_tell(last, near):
    """They go over three fifths of the range, and each began after other turns."""
    turns = ((-1.0, 1.0), (1.0, -1.0), last)
    kinds = {"sweep": 1.0, "walk": 0.6, "waves": 0.6}
    recordings = [
        after_turns(kind, before, part)
        for (kind, part), before in zip(kinds.items(), turns, strict=True)
    ]
    view = view_of_recordings(tuple(recordings), Lab())
    own = with_individual_initial_states(view, with_shared_initial_state(view))
    assert own.rms < near * with_reversals(own, turns).rms
    assert own.rms < 0.5 * view.rms


@pytest.mark.parametrize("phase", [0.1, 3.0, 6.0])
def test_a_drive_that_goes_round_and_round_may_have_run_before_its_recording(phase):
    turn = np.linspace(0.0, 8 * np.pi, 900)
    sweep, running = np.linspace(-1.0, 1.0, 100), 0.6 * np.sin(turn + phase) - 0.1
    long_before = 0.6 * np.sin(np.linspace(-80.0, 0.0, 9000) + phase) - 0.1
    met = left_by(running[:1], left_by(long_before, np.zeros(len(THRESHOLD))))
    found = [
        memory_after(running, reversals[1])
        for reversals in shared_hypotheses([sweep, running], ZERO_VOLTS)
    ]
    assert len(found) == 4 * HABITS
    assert min(np.abs(memory - met).max() for memory in found) < 2e-3


@pytest.mark.parametrize(
    ("before", "is_shared"),
    [
        ((at_rest,) * 3, True),
        ((cycled_the_other_way,) * 3, True),
        ((cycled, forgotten, cycled), False),  # no shared one is beyond doubt
        ((forgotten,) * 3, False),  # nor this, and beside cycled drives a clock seems to slip
        ((cycled,) * 3, False),
    ],
    ids=["at rest", "the other way", "one forgotten", "all forgotten", "cycled"],
)
def test_faults_are_looked_for_beside_the_memory_that_leaves_least(before, is_shared):
    """Nothing is wrong with the data; only a shared initial state that is evident stays."""
    view = view_after(*before)
    clean, faults, known = repair_faults(view, SERIAL)
    assert faults == {}
    assert known is not None
    shared = known[0].nuisance.reversals
    assert clean.nuisance.reversals == (shared if is_shared else view.nuisance.reversals)
    assert not clean.nuisance.free


def test_a_shared_initial_state_is_not_evident_where_it_leaves_most_of_the_error():
    """Six times the noise hides how much better it does than drives that were cycled."""
    chance, noisy = np.random.default_rng(5), []
    for one in recordings_after(*(cycled_the_other_way,) * 3):
        moved_m = one.displacement_m()
        noise_m = 6.0 * NOISE * float(np.ptp(moved_m)) * chance.normal(size=one.samples)
        noisy.append(with_displacement(one, moved_m + noise_m))
    view = view_of_recordings(tuple(noisy), Lab())
    clean, _, known = repair_faults(view, SERIAL)
    assert known is not None
    shared, own = known
    assert 0.5 * view.rms < shared.rms < 0.9 * view.rms
    assert is_shared_state_as_good(shared, own, view)
    assert clean.nuisance.reversals == view.nuisance.reversals


REVERSALS = (1.0, 0.3, 0.7, -0.2)


def drive_with_holds() -> np.ndarray:
    """Return a drive on a grid that turns, rests, and goes on either way."""
    way = np.round(np.sin(np.linspace(0.0, 40.0, 20_000)) ** 3, 3)
    way[3_000:3_400] = way[3_000]
    return way


def track(drive: np.ndarray) -> Track:
    place = np.unique(np.random.default_rng(3).integers(1, len(drive), 400))
    return Track(
        name="sweep",
        rate_Hz=1000.0,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=drive,
        other_drives={},
        rows=place,
        block=place * 15 // len(drive),
    )


def test_a_recording_too_long_to_keep_its_states_has_the_same_static_response():
    """Made chunk by chunk: the ends of two of them are compared, where memory is handed on."""
    weight = np.random.default_rng(5).normal(size=SHARED)
    drive = np.resize(drive_with_holds(), MAX_KEPT + 1)
    long = NuisanceClass(histories=(History(track=track(drive), reversals=REVERSALS),))
    head = drive[: 2 * CHUNK + 1000]
    columns = np.empty((len(head), SHARED), order="F")
    write_shared_columns(columns, *states_along(head, REVERSALS), head)
    expected = columns @ weight
    static = long.static(0, weight)
    assert static.shape == drive.shape
    np.testing.assert_allclose(static[: len(head)], expected, rtol=1e-9, atol=1e-9)
    assert "states" not in vars(long.histories[0])
