"""Every effect of the catalogue, hidden in a stage whose loops are no sum of plays.

The stage follows Dahl's law of friction and has one effect, written here by another formula than
the model's. A fit without it, its diagnosis and the refitted model must name the effect alone,
find its physical numbers and state what the model gains. A healthy stage is accused of nothing.

An unknown initial state, which friction forgets, and drift are hidden in test_selection.py, faults
of the data in test_data_faults.py, shapes of loops in test_structure.py.
"""

from collections.abc import Callable, Mapping
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from piezoid import diagnose, fit
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import EFFECTS, effect_named
from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnoses, write_diagnosis
from piezoid.digests import unseal
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording
from tests.diagnosis.bench import causes, effects_of
from tests.laws import LAWS
from tests.plays_alone import fit_one_order, fit_plays_alone

from .played import WIDTH, moved, recorded_as, with_another_axis

pytestmark = pytest.mark.slow

RATE_Hz = 500.0
TIME_s = np.arange(3000) / RATE_Hz
HALF_STROKE_m = 1.5e-5
NOISE = 1e-3  # of half the stroke
PATH_STEP = 0.01  # of half the range, on the way through the turns before a recording
CYCLED = (0.0, -1.0, 1.0, -1.0, 1.0)
LAW = "dahl"
Reading = Callable[[str, Array, Array], Array]  # (recording, drive, response) -> what is read


def triangle(frequency_Hz: float, first: float, last: float) -> Array:
    turn = 2.0 * np.pi * (frequency_Hz * TIME_s - 0.25)
    return np.linspace(first, last, len(TIME_s)) * 2.0 / np.pi * np.arcsin(np.sin(turn))


TONES_Hz = np.arange(1.0, 90.0, 1.5)
TONES = np.sin(2.0 * np.pi * np.outer(TIME_s, TONES_Hz) + TONES_Hz**2).sum(axis=1)
ONE_SPEED = {
    "loops": triangle(1.1, 1.0, 0.3),
    "waves": np.linspace(0.2, 1.0, len(TIME_s)) * np.sin(2.0 * np.pi * 0.7 * TIME_s),
}
SPEEDS = ONE_SPEED | {"fast": triangle(5.3, 1.0, 0.4)}
WITH_SLOW = SPEEDS | {"slow": triangle(0.35, 0.4, 0.9)}
FASTER = {"loops": ONE_SPEED["loops"], "fast": triangle(9.3, 1.0, 0.4)}
WITH_TONES = ONE_SPEED | {"tones": TONES / 30.0}


def response_of(law: str, drive: Array, turns: tuple[float, ...]) -> Array:
    """Return the response of a law to a drive after turning points in front of it."""
    path = [
        np.linspace(first, last, max(2, int(abs(last - first) / PATH_STEP)))[:-1]
        for first, last in pairwise((*turns, float(drive[0])))
    ]
    past = np.concatenate(path)
    whole = np.concatenate([past, drive])
    response = moved(whole, np.zeros(len(WIDTH)))[0] if law == "sum of plays" else LAWS[law](whole)
    return response[len(past) :]


def as_it_is(_: str, __: Array, response: Array) -> Array:
    return response


def recorded(
    drives: Mapping[str, Array],
    read: Reading = as_it_is,
    *,
    reaches: Callable[[Array], Array] = np.array,
    law: str = LAW,
) -> tuple[Recording, ...]:
    """Record the stage; reaches is (drive) -> what reaches the ceramic."""
    chance, recordings = np.random.default_rng(1), []
    for name, drive in drives.items():
        before = tuple(float(reaches(np.full(1, command))[0]) for command in CYCLED)
        response = response_of(law, reaches(drive), before)
        reading = read(name, drive, response) + NOISE * chance.normal(size=len(drive))
        recordings.append(recorded_as(name, RATE_Hz, drive, HALF_STROKE_m * reading))
    return tuple(recordings)


def held_back(signal: Array, time_s: float) -> Array:
    """Return a first-order lag: what came is averaged with what was there."""
    kept = np.exp(-1.0 / (time_s * RATE_Hz))
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], signal, zi=[kept * signal[0]])[0])


def held_back_s(time_s: float) -> float:
    """Return by how much that comes late when all is slow."""
    kept = np.exp(-1.0 / (time_s * RATE_Hz))
    return float(kept / (1.0 - kept) / RATE_Hz)


def slewed(drive: Array, step: float) -> Array:
    reached = drive.copy()
    for k in range(1, len(drive)):
        reached[k] = reached[k - 1] + np.clip(drive[k] - reached[k - 1], -step, step)
    return reached


def rung(_: str, __: Array, response: Array) -> Array:
    """Pass through a mode of 40 Hz and quality 15, integrated eight times as finely."""
    w, time_s = 2.0 * np.pi * 40.0, np.arange(8 * len(TIME_s)) / (8.0 * RATE_Hz)
    fine = np.interp(time_s, TIME_s, response) - response[0]
    return np.asarray(response[0] + lsim(([w**2], [1.0, w / 15.0, w**2]), fine, time_s)[1][::8])


def crept(_: str, __: Array, response: Array) -> Array:
    times_s = np.geomspace(0.02, 60.0, 12)
    return response + 0.01 * sum(held_back(response, time_s) for time_s in times_s)


def sensitive(name: str, _: Array, response: Array) -> Array:
    return response * np.where((TIME_s >= 2.5) | (name == "waves"), 1.03, 1.0)


def walls_late(_: str, drive: Array, response: Array) -> Array:
    return 0.4 * drive + held_back(response - 0.4 * drive, 2e-3)


def coupled() -> tuple[Recording, ...]:
    """Let a displacement hold 7.5 nm for every volt at the other axis."""
    other = 0.02 * np.sin(2.3 * TIME_s + 1.0) + 0.0075 * np.sin(12.1 * TIME_s)
    return tuple(map(with_another_axis, recorded(ONE_SPEED, lambda _, __, x: x + other)))


def ended_at(highest: float, law: str = LAW) -> tuple[Recording, ...]:
    """Let the supply end at a part of the half range."""
    return recorded(ONE_SPEED, reaches=lambda drive: np.minimum(drive, highest), law=law)


STAGES: Mapping[str, Callable[[], tuple[Recording, ...]]] = {
    "amplifier_saturation": lambda: ended_at(0.8),
    "creep": lambda: recorded(ONE_SPEED, crept),
    "cross_coupling": coupled,
    "delay": lambda: recorded(SPEEDS, lambda _, __, x: np.interp(TIME_s - 1.3e-3, TIME_s, x)),
    "gain_change": lambda: recorded(ONE_SPEED, sensitive),
    "lag": lambda: recorded(WITH_SLOW, lambda _, __, x: held_back(x, 3e-3)),
    "mains_interference": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * 50.0 * TIME_s + len(_))
    ),
    "rate_dependence": lambda: recorded(SPEEDS, walls_late),
    # a filter behind friction is taken for loop shape in part: the gain is stated on plays
    "resonance": lambda: recorded(WITH_TONES, rung, law="sum of plays"),
    "sensor_periodic_error": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * x / 0.06 + 0.7)
    ),
    # friction behind it passes for a lag of the whole stage
    "slew_limit": lambda: recorded(
        FASTER, reaches=lambda drive: slewed(drive, 0.03), law="sum of plays"
    ),
}


# Extended together with loop shape; for a periodic error: test_loop_shape.py.
WITH_LOOP_SHAPE = ("creep", "delay")


@cache
def known(name: str) -> tuple[Diagnosis, AxisModel]:
    """Return the diagnosis of a stage, and the model that it extended."""
    with pytest.MonkeyPatch.context() as patch:
        fit_one_order(patch)
        if name not in WITH_LOOP_SHAPE:
            fit_plays_alone(patch)
        diagnosis = diagnose(STAGES[name]())
    assert diagnosis.model is not None
    return diagnosis, diagnosis.model


def part_of(name: str) -> Any:
    (part,) = known(name)[1].extensions
    return part


@pytest.mark.parametrize("name", STAGES)
def test_a_hidden_effect_is_named_alone_with_its_interval_and_its_gain(name: str) -> None:
    diagnosis, extended = known(name)
    assert causes(diagnosis) == (name,)
    finding = next(finding for finding in diagnosis.findings if finding.effect == name)
    assert finding.size.ci95[0] < finding.size.value < finding.size.ci95[1]
    assert finding.held_out_gain > 0.0
    assert finding.held_out_rms_after_m < finding.held_out_rms_before_m
    assert extended.quality.held_out_rms_m < diagnosis.baseline.rms_m
    if name not in ("delay", "lag"):  # a model has a lag before
        assert part_of(name)


@pytest.mark.usefixtures("plays_alone", "one_order")
@pytest.mark.parametrize(("law", "drives"), [("dahl", WITH_SLOW), ("duhem", ONE_SPEED)])
def test_a_healthy_stage_is_accused_of_nothing_and_has_a_bound_on_everything(
    law: str, drives: Mapping[str, Array]
) -> None:
    """A Bouc-Wen ceramic, with loop shape: test_budget.py."""
    diagnosis = diagnose(recorded(drives, law=law))
    assert causes(diagnosis) == ()
    listed = {absent.effect for absent in diagnosis.not_detected} | set(diagnosis.names)
    assert listed == {effect.name for effect in EFFECTS}
    assert diagnosis.unexplained is not None
    assert 0.0 < diagnosis.unexplained.p_value <= 1.0
    for absent in diagnosis.not_detected:
        assert len(absent.reason) > 20
        if absent.upper_bound_m is not None and absent.detection_limit_m is not None:
            assert 0.0 < absent.upper_bound_m <= absent.detection_limit_m


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_diagnosis_is_the_same_whatever_the_number_of_threads_and_survives_its_file() -> None:
    messages: set[str] = set()
    alone = known("cross_coupling")[0]
    together = diagnose(STAGES["cross_coupling"](), threads=3, progress=messages.add)
    written = write_diagnosis(alone)
    assert write_diagnosis(together) == written
    assert read_diagnoses(written)[0] == alone
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert content["final"]["held_out_rms_m"] == alone.final.rms_m
    assert {"testing lag", "comparing cross coupling with confounded effects"} <= messages


def test_a_supply_that_ends_is_a_limit_at_its_voltage_and_none_where_no_drive_came() -> None:
    part = part_of("amplifier_saturation")
    assert part.high_V == pytest.approx(9.0, abs=0.03)
    assert part.low_V is None


def test_creep_has_its_share_of_a_step_for_each_decade_of_time() -> None:
    part = part_of("creep")
    decade = np.log10(part.time_s[1] / part.time_s[0])
    assert np.mean(part.share) / decade == pytest.approx(0.01 * 11.0 / np.log10(3000.0), rel=0.1)


def test_what_another_axis_adds_is_told_for_each_of_its_volts() -> None:
    part = part_of("cross_coupling")
    assert part.axis == "y"
    assert part.gain_m_per_V == pytest.approx(0.02 * HALF_STROKE_m / 40.0, rel=0.15)


@pytest.mark.parametrize(("name", "late_s"), [("delay", 1.3e-3), ("lag", held_back_s(3e-3))])
def test_what_comes_late_has_its_time(name: str, late_s: float) -> None:
    _, extended = known(name)
    assert not extended.extensions  # the lag of the model takes it over
    assert extended.lag.time_s == pytest.approx(late_s, rel=0.1)


def test_a_gain_changes_when_and_by_as_much_as_it_did() -> None:
    part = part_of("gain_change")
    assert (part.recording, part.later) == ("loops", ("waves",))
    assert part.instant_s == pytest.approx(2.5, abs=2.0 / RATE_Hz)
    assert part.ratio == pytest.approx(1.03, abs=3.0 * part.std[0])
    assert part.std[0] < 2e-3


def test_a_mode_has_its_frequency_and_is_as_sharp_as_it_is() -> None:
    part = part_of("resonance")
    assert part.frequency_Hz == pytest.approx(40.0, rel=1e-3)
    assert part.quality == pytest.approx(15.0, rel=0.01)
    assert part.participation == pytest.approx(1.0, abs=0.01)


def test_hum_is_as_large_and_as_late_in_every_recording_as_it_was() -> None:
    part = part_of("mains_interference")
    assert part.frequency_Hz == pytest.approx(50.0, rel=1e-4)
    assert {hum.recording for hum in part.hums} == set(ONE_SPEED)
    for hum in part.hums:
        said = complex(hum.sine_m[0], hum.cosine_m[0])
        was = 4e-3 * HALF_STROKE_m * np.exp(1j * len(hum.recording))
        assert abs(said - was) < 0.05 * abs(was)


def test_a_periodic_error_has_its_wavelength_and_amplitude_however_steep() -> None:
    part = part_of("sensor_periodic_error")
    assert part.wavelength_m == pytest.approx(0.06 * HALF_STROKE_m, rel=3e-3)
    assert part.amplitude_m[0] == pytest.approx(4e-3 * HALF_STROKE_m, rel=0.03)
    assert part.amplitude_m[1] < 0.02 * part.amplitude_m[0]


def test_a_slew_limit_is_told_in_volts_for_each_second() -> None:
    part = part_of("slew_limit")
    assert part.limit_V_per_s == pytest.approx(0.03 * 5.0 * RATE_Hz, rel=0.02)


@pytest.mark.usefixtures("plays_alone")
def test_a_supply_that_ends_far_below_the_command_is_found_with_its_past() -> None:
    """Half of the command never comes, nor did it before: all turns are at the end."""
    recordings = ended_at(0.0, law="sum of plays")
    found = diagnose(recordings)
    (finding,) = effects_of(found)
    assert finding.effect == "amplifier_saturation"
    top_V = max(float(one.voltage_V().max()) for one in recordings)
    cut_percent = 100.0 * (top_V - 5.0) / top_V
    assert finding.size.ci95[0] < cut_percent < finding.size.ci95[1]
    assert found.final.rms_m < 1.5 * found.noise_floor_rms_m


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_an_amplifier_many_times_too_slow_is_found_and_is_no_butterfly() -> None:
    """The fastest recording goes against its drive; slow ones say that the ceramic does not."""
    limit_V_per_s = 12.5
    step = limit_V_per_s / (5.0 * RATE_Hz)
    drives = {name: WITH_SLOW[name] for name in ("loops", "fast", "slow")}
    recordings = recorded(drives, reaches=lambda drive: slewed(drive, step), law="sum of plays")
    (finding,) = effects_of(diagnose(recordings))
    assert finding.effect == "slew_limit"
    assert finding.size.value == pytest.approx(limit_V_per_s, rel=2e-3)
    assert finding.size.ci95[0] < limit_V_per_s < finding.size.ci95[1]


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_without_what_is_known_of_its_past_a_stage_was_cycled_over_its_range() -> None:
    recordings = recorded(ONE_SPEED, sensitive, law="sum of plays")
    without, recording = fit(recordings).axes["x"], recordings[0]
    cycled = effect_named("initial_state").without(without, recording)
    assert cycled is not None
    assert [start.recording for start in cycled.starts].count(recording.name) == 1
    (start,) = [start for start in cycled.starts if start.recording == recording.name]
    first_V = float(recording.voltage_V()[start.first])
    low_V, high_V = without.voltage_V
    # up to the top and down to the first value: each play is dragged, or has stayed at the top
    threshold_V = without.hysteresis.plays.threshold
    from_centre = np.array([low_V, high_V, first_V]) - without.hysteresis.voltage_offset_V
    states_V, expected_V = play_columns(from_centre, threshold_V, np.zeros(len(threshold_V)))
    assert len(states_V) == 3
    np.testing.assert_allclose(start.memory_V, expected_V, atol=1e-9)
