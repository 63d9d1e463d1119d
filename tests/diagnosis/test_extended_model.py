"""What is hidden in recordings comes back as the part of the model that stands for it.

A stage that is a sum of plays is read with one cause in its way, written here by another formula
than the model's. The model is fitted without it, the diagnosis names it, and the refitted part has
its physical numbers.
"""

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter, lsim

from piezoid import diagnose, fit
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.effects import effect_named
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.records.recording import Recording
from tests.diagnosis.bench import causes, effects_of

from .played import HALF_STROKE_m, memory_after, moved, recorded_as, with_another_axis

RATE_Hz = 500.0
TIME_s = np.arange(3000) / RATE_Hz
NOISE = 1e-3  # of half the stroke: more than fixed thresholds miss of twelve plays
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
SPEEDS = ONE_SPEED | {"fast": triangle(5.3, 1.0, 0.4), "slow": triangle(0.35, 0.4, 0.9)}
FASTER = SPEEDS | {"fast": triangle(9.3, 1.0, 0.4)}
WITH_TONES = ONE_SPEED | {"tones": TONES / 30.0}


def recorded(
    drives: Mapping[str, Array],
    read: Reading,
    *,
    reaches: Callable[[Array], Array] = np.array,
    highest: float = 1.0,
) -> tuple[Recording, ...]:
    """Record the stage.

    reaches  (drive) -> what reaches the ceramic
    highest  that did before
    """
    chance, found = np.random.default_rng(1), []
    for name, drive in drives.items():
        first = min(float(drive[0]), highest)
        response, _ = moved(reaches(drive), memory_after(lambda _: (-1.0, highest), first))
        shown = read(name, drive, response) + NOISE * chance.normal(size=len(drive))
        found.append(recorded_as(name, RATE_Hz, drive, HALF_STROKE_m * shown))
    return tuple(found)


def as_it_is(_: str, __: Array, response: Array) -> Array:
    return response


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


def ended_at(highest: float) -> tuple[Recording, ...]:
    """Let the supply end at a part of the half range."""
    return recorded(
        ONE_SPEED, as_it_is, reaches=lambda drive: np.minimum(drive, highest), highest=highest
    )


STAGES: Mapping[str, Callable[[], tuple[Recording, ...]]] = {
    "amplifier_saturation": lambda: ended_at(0.8),
    "creep": lambda: recorded(ONE_SPEED, crept),
    "cross_coupling": coupled,
    "delay": lambda: recorded(SPEEDS, lambda _, __, x: np.interp(TIME_s - 1.3e-3, TIME_s, x)),
    "gain_change": lambda: recorded(ONE_SPEED, sensitive),
    "lag": lambda: recorded(SPEEDS, lambda _, __, x: held_back(x, 3e-3)),
    "mains_interference": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * 50.0 * TIME_s + len(_))
    ),
    "rate_dependence": lambda: recorded(SPEEDS, walls_late),
    "resonance": lambda: recorded(WITH_TONES, rung),
    "sensor_periodic_error": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * x / 0.06 + 0.7)
    ),
    "slew_limit": lambda: recorded(FASTER, as_it_is, reaches=lambda drive: slewed(drive, 0.03)),
}


@cache
def known(name: str) -> tuple[Diagnosis, AxisModel, AxisModel]:
    """Return what is said of a stage, the model without its cause, and with it."""
    recordings = STAGES[name]()
    model = fit(recordings)
    found = diagnose(recordings, model=model)
    return found, model.axes["x"], model.extended(found).axes["x"]


def part_of(name: str) -> Any:
    (part,) = known(name)[2].extensions
    return part


@pytest.mark.parametrize("name", STAGES)
def test_a_hidden_cause_is_named_alone_with_its_interval(name: str) -> None:
    found, _, _ = known(name)
    assert causes(found) == (name,)
    finding = next(finding for finding in found.findings if finding.effect == name)
    assert finding.size.ci95[0] < finding.size.value < finding.size.ci95[1]


@pytest.mark.parametrize("name", [name for name in STAGES if name not in ("delay", "lag")])
def test_the_model_is_better_with_its_part(name: str) -> None:
    """A model has a lag of its own before anything is found."""
    _, without, extended = known(name)
    assert part_of(name)
    assert extended.quality.held_out_rms_m < without.quality.held_out_rms_m


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


@pytest.mark.parametrize(
    ("name", "of_part", "late_s"),
    [
        ("delay", "delay_s", 1.3e-3),
        ("lag", "lag_s", held_back_s(3e-3)),
        ("rate_dependence", "time_s", held_back_s(2e-3)),
    ],
)
def test_what_comes_late_has_its_time(name: str, of_part: str, late_s: float) -> None:
    _, _, extended = known(name)
    own_s = sum(float(getattr(part, of_part)) for part in extended.extensions)
    assert own_s + extended.lag.time_s == pytest.approx(late_s, rel=0.04)


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
    assert part.wavelength_m == pytest.approx(0.06 * HALF_STROKE_m, rel=1e-3)
    assert part.amplitude_m[0] == pytest.approx(4e-3 * HALF_STROKE_m, rel=0.03)
    assert part.amplitude_m[1] < 0.02 * part.amplitude_m[0]


def test_a_slew_limit_is_told_in_volts_for_each_second() -> None:
    part = part_of("slew_limit")
    assert part.limit_V_per_s == pytest.approx(0.03 * 5.0 * RATE_Hz, rel=0.02)


@pytest.mark.parametrize("highest", [0.4, 0.0])
def test_a_supply_that_ends_far_below_the_command_is_found_with_its_past(highest: float) -> None:
    """Half of the command never comes, nor did it before: all turns are at the end."""
    recordings = ended_at(highest)
    found = diagnose(recordings)
    (finding,) = effects_of(found)
    assert finding.effect == "amplifier_saturation"
    top_V = max(float(one.voltage_V().max()) for one in recordings)
    cut_percent = 100.0 * (top_V - 5.0 - 5.0 * highest) / top_V
    assert finding.size.ci95[0] < cut_percent < finding.size.ci95[1]
    assert found.final.rms_m < 1.5 * found.noise_floor_rms_m


@pytest.mark.parametrize(
    ("drives", "limit_V_per_s"),
    [
        (SPEEDS, 25.0),
        (SPEEDS, 12.5),
        ({name: SPEEDS[name] for name in ("loops", "fast")}, 25.0),
        (FASTER | WITH_TONES, 125.0),
    ],
)
def test_an_amplifier_many_times_too_slow_is_found_and_is_no_butterfly(
    drives: Mapping[str, Array], limit_V_per_s: float
) -> None:
    """The fastest recording goes against its drive; slow ones say that the ceramic does not."""
    step = limit_V_per_s / (5.0 * RATE_Hz)
    diagnosis = diagnose(recorded(drives, as_it_is, reaches=lambda drive: slewed(drive, step)))
    (finding,) = effects_of(diagnosis)
    assert finding.effect == "slew_limit"
    assert finding.size.value == pytest.approx(limit_V_per_s, rel=2e-3)
    assert finding.size.ci95[0] < limit_V_per_s < finding.size.ci95[1]


def test_without_what_is_known_of_its_past_a_stage_was_cycled_over_its_range() -> None:
    _, without, _ = known("gain_change")
    recording = STAGES["gain_change"]()[0]
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
