"""The usual history before a recording is not an unknown initial state; a careless one is."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pytest

from piezoid.diagnosis.candidate import Candidate, structural_candidate
from piezoid.diagnosis.effects import initial_state
from piezoid.diagnosis.nuisance import (
    CHUNK,
    DELIBERATE,
    MAX_KEPT,
    History,
    NuisanceClass,
    memory_after,
    shared_hypotheses,
    states_along,
)
from piezoid.diagnosis.nuisance_columns import (
    SHARED,
    THRESHOLD,
    write_shared_columns,
)
from piezoid.diagnosis.nuisance_search import (
    OTHER_INITIAL_STATES,
    is_shared_state_as_good,
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.residual_view import View, with_free_memory, with_reversals
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.selection import repair_faults
from piezoid.diagnosis.signals import with_displacement
from piezoid.identification.fit import fit
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import read_campaign, recorded_zoo_stage, thinned, view_of_recordings
from .play_recordings import (
    NOISE,
    WIDTH,
    HALF_STROKE_m,
    at_rest,
    cycled,
    cycled_the_other_way,
    drive_recording,
    forgotten,
    play_response,
    recordings_after,
    view_after,
)
from .play_stage import drive


def structure_of(view: View) -> Candidate:
    """Test the initial state as a search does that finds no other effect."""
    individual = with_individual_initial_states(view, with_shared_initial_state(view))
    final = (
        with_free_memory(individual) if individual.rms < OTHER_INITIAL_STATES * view.rms else view
    )
    judgement = structural_candidate(initial_state.EFFECT, final)
    return judgement[1]


@pytest.mark.parametrize(
    "turns",
    [
        (cycled,) * 3,
        (at_rest,) * 3,
        (cycled_the_other_way,) * 3,
        (cycled_the_other_way, None, None),
        (at_rest, None, None),
    ],
    ids=["cycled", "demagnetised", "cycled in reverse", "continued", "demagnetised once"],
)
def test_a_usual_history_is_not_an_unknown_initial_state(turns):
    view = view_after(*turns)
    assert not structure_of(view).is_significant
    if turns[0] is not cycled:
        # although the initial assumption, cycled drives, is wrong
        assert (
            with_individual_initial_states(view, with_shared_initial_state(view)).rms
            < 0.6 * view.rms
        )


def test_a_different_history_of_one_recording_is_an_unknown_initial_state():
    structure = structure_of(view_after(cycled, forgotten, cycled))
    assert structure.is_significant
    assert structure.cv.gain > 2.0 * initial_state.EFFECT.minimum_gain


@pytest.mark.usefixtures("few_rows")
def test_a_campaign_with_different_histories_needs_individual_initial_states():
    campaign = draw_campaign(104133, truth="preisach", effects={"initial_state": 2.5})
    view = view_of_recordings(*read_campaign(campaign))
    shared = with_shared_initial_state(view)
    individual = with_individual_initial_states(view, shared)
    assert individual.rms < 0.85 * shared.rms
    assert not is_shared_state_as_good(shared, individual, view)


@pytest.mark.slow
@pytest.mark.usefixtures("one_order", "few_rows")
def test_an_initial_state_that_decays_is_not_a_step_of_the_zero():
    """A step at the first maximum of the drive left 6.8 times the noise."""
    recordings, lab, noise_rms_m = recorded_zoo_stage("preisach", "quarter", 48522301)
    sweep = [recording for recording in recordings if recording.name == "sweep.csv"]
    model = fit(thinned(sweep, 8), lab=lab)["x"]
    assert model.quality.rms_m < 1.5 * noise_rms_m


DELIBERATE_HISTORIES = DELIBERATE + 2  # deliberate histories, and the two that end at 0 V
ZERO_VOLTS = -1.3  # in half ranges from the centre of the drive
THINNING = 6  # samples of the drive per recorded sample


def memory_behind(path: Array, memory: Array) -> Array:
    return play_columns(path, THRESHOLD, memory)[1]


def after_turns(name: str, reversals: Sequence[float], scale: float) -> Recording:
    """Record a scaled drive after these turns with a stage of plays and friction."""
    rate_Hz, full_drive = drive(name)
    field = scale * full_drive[::THINNING]
    moves = pairwise([0.0, *reversals, float(field[0])])
    history = [np.linspace(start, end, 400)[:-1] for start, end in moves]
    path = np.concatenate([*history, field])
    response, _ = play_response(path, np.zeros(len(WIDTH)))
    friction = np.zeros(len(path))
    for i, step in enumerate(np.diff(path), start=1):
        friction[i] = friction[i - 1] + step - 2.0 * abs(step) * friction[i - 1]
    response = (response + friction)[-len(field) :]
    noise = np.random.default_rng(len(name)).normal(0.0, NOISE * np.ptp(response), len(field))
    return drive_recording(name, rate_Hz / THINNING, field, HALF_STROKE_m * (response + noise))


@pytest.mark.parametrize(
    ("last_turns", "max_ratio"),
    [((-1.0, 1.0), 1.15), ((0.0,), 1.8)],
    ids=["cycled", "switched on"],
)
def test_initial_states_of_a_stage_with_friction_are_found_from_small_drives(
    last_turns, max_ratio
):
    """Two drives cover three fifths of the range, and each began after other turns."""
    turns = ((-1.0, 1.0), (1.0, -1.0), last_turns)
    scales = {"sweep": 1.0, "walk": 0.6, "waves": 0.6}
    recordings = [
        after_turns(name, reversals, scale)
        for (name, scale), reversals in zip(scales.items(), turns, strict=True)
    ]
    view = view_of_recordings(tuple(recordings))
    individual = with_individual_initial_states(view, with_shared_initial_state(view))
    assert individual.rms < max_ratio * with_reversals(individual, turns).rms
    assert individual.rms < 0.5 * view.rms


@pytest.mark.parametrize("phase", [0.1, 3.0, 6.0])
def test_a_periodic_drive_may_have_run_before_its_recording(phase):
    turn = np.linspace(0.0, 8 * np.pi, 900)
    sweep, periodic = np.linspace(-1.0, 1.0, 100), 0.6 * np.sin(turn + phase) - 0.1
    long_before = 0.6 * np.sin(np.linspace(-80.0, 0.0, 9000) + phase) - 0.1
    expected = memory_behind(periodic[:1], memory_behind(long_before, np.zeros(len(THRESHOLD))))
    memories = [
        memory_after(periodic, reversals[1])
        for reversals in shared_hypotheses([sweep, periodic], ZERO_VOLTS)
    ]
    assert len(memories) == 4 * DELIBERATE_HISTORIES
    assert min(np.abs(memory - expected).max() for memory in memories) < 2e-3


@pytest.mark.parametrize(
    ("turns", "is_shared"),
    [
        ((at_rest,) * 3, True),
        ((cycled_the_other_way,) * 3, True),
        ((cycled, forgotten, cycled), False),  # a shared state is not evident
        ((forgotten,) * 3, False),  # nor here, and cycled drives would suggest a clock slip
        ((cycled,) * 3, False),
    ],
    ids=["demagnetised", "cycled in reverse", "one forgotten", "all forgotten", "cycled"],
)
def test_faults_are_searched_for_with_an_evident_shared_initial_state(turns, is_shared):
    """The data have no fault."""
    view = view_after(*turns)
    clean, faults, initial_states = repair_faults(view, SERIAL)
    assert faults == {}
    shared = initial_states[0].nuisance.reversals
    assert clean.nuisance.reversals == (shared if is_shared else view.nuisance.reversals)
    assert not clean.nuisance.free


def test_a_shared_initial_state_that_leaves_most_of_the_error_is_not_evident():
    """Six times the noise hides its advantage over cycled drives."""
    rng, noisy = np.random.default_rng(5), []
    for recording in recordings_after(*(cycled_the_other_way,) * 3):
        displacement_m = recording.displacement_m()
        noise_m = 6.0 * NOISE * float(np.ptp(displacement_m)) * rng.normal(size=recording.samples)
        noisy.append(with_displacement(recording, displacement_m + noise_m))
    view = view_of_recordings(tuple(noisy))
    clean, _, initial_states = repair_faults(view, SERIAL)
    shared, individual = initial_states
    assert 0.5 * view.rms < shared.rms < 0.9 * view.rms
    assert is_shared_state_as_good(shared, individual, view)
    assert clean.nuisance.reversals == view.nuisance.reversals


REVERSALS = (1.0, 0.3, 0.7, -0.2)


def drive_with_holds() -> np.ndarray:
    """Return a quantised drive with reversals and holds."""
    drive = np.round(np.sin(np.linspace(0.0, 40.0, 20_000)) ** 3, 3)
    drive[3_000:3_400] = drive[3_000]
    return drive


def track(drive: np.ndarray) -> Track:
    rows = np.unique(np.random.default_rng(3).integers(1, len(drive), 400))
    return Track(
        name="sweep",
        rate_Hz=1000.0,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=drive,
        other_drives={},
        rows=rows,
        block=rows * 15 // len(drive),
    )


def test_a_recording_too_long_to_store_its_states_has_the_same_static_response():
    """The response is computed in chunks; two boundaries between chunks are compared."""
    weight = np.random.default_rng(5).normal(size=SHARED)
    drive = np.resize(drive_with_holds(), MAX_KEPT + 1)
    nuisance = NuisanceClass(histories=(History(track=track(drive), reversals=REVERSALS),))
    head = drive[: 2 * CHUNK + 1000]
    columns = np.empty((len(head), SHARED), order="F")
    write_shared_columns(columns, *states_along(head, REVERSALS), head)
    expected = columns @ weight
    static = nuisance.static(0, weight)
    assert static.shape == drive.shape
    np.testing.assert_allclose(static[: len(head)], expected, rtol=1e-9, atol=1e-9)
    assert "states" not in vars(nuisance.histories[0])
