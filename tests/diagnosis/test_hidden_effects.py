"""Every effect of the catalogue, hidden in a stage whose loops are not a sum of plays.

The stage follows Dahl's friction law and has one effect, computed by another formula than the
model's. The diagnosis must name this effect only, estimate its parameters and state the gain. On a
healthy stage it must name nothing.

Initial states and drift are hidden in test_selection.py, faults of the data in
test_data_faults.py, and loop shapes in test_structure.py.
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
from tests.diagnosis.bench import causes, effects_of, finding_of
from tests.laws import LAWS
from tests.plays_alone import fit_few_rows, fit_one_order, fit_plays_alone

from .play_recordings import WIDTH, drive_recording, play_response, with_another_axis

pytestmark = pytest.mark.slow

RATE_Hz = 500.0
TIME_s = np.arange(3000) / RATE_Hz
HALF_STROKE_m = 1.5e-5
NOISE = 1e-3  # of half the stroke
PATH_STEP = 0.01  # of half the range, along the turns before a recording
CYCLED = (0.0, -1.0, 1.0, -1.0, 1.0)
LAW = "dahl"
SLEW_LIMIT_V_per_s = 12.5
Reading = Callable[[str, Array, Array], Array]  # (recording, drive, response) -> reading


def triangle(frequency_Hz: float, initial: float, final: float) -> Array:
    turn = 2.0 * np.pi * (frequency_Hz * TIME_s - 0.25)
    return np.linspace(initial, final, len(TIME_s)) * 2.0 / np.pi * np.arcsin(np.sin(turn))


TONES_Hz = np.arange(1.0, 90.0, 1.5)
TONES = np.sin(2.0 * np.pi * np.outer(TIME_s, TONES_Hz) + TONES_Hz**2).sum(axis=1)
ONE_SPEED = {
    "loops": triangle(1.1, 1.0, 0.3),
    "waves": np.linspace(0.2, 1.0, len(TIME_s)) * np.sin(2.0 * np.pi * 0.7 * TIME_s),
}
SPEEDS = ONE_SPEED | {"fast": triangle(5.3, 1.0, 0.4)}
TWO_SPEEDS = {"loops": ONE_SPEED["loops"], "fast": SPEEDS["fast"]}
WITH_SLOW = SPEEDS | {"slow": triangle(0.35, 0.4, 0.9)}
WITH_TONES = {"waves": ONE_SPEED["waves"], "tones": TONES / 30.0}


def response_of(law: str, drive: Array, turns: tuple[float, ...]) -> Array:
    """Return the response of a law to a drive after initial turning points."""
    path = [
        np.linspace(start, target, max(2, int(abs(target - start) / PATH_STEP)))[:-1]
        for start, target in pairwise((*turns, float(drive[0])))
    ]
    history = np.concatenate(path)
    full_drive = np.concatenate([history, drive])
    if law == "sum of plays":
        return play_response(full_drive, np.zeros(len(WIDTH)))[0][len(history) :]
    return LAWS[law](full_drive)[len(history) :]


def unchanged(_: str, __: Array, response: Array) -> Array:
    return response


def recorded(
    drives: Mapping[str, Array],
    read: Reading = unchanged,
    *,
    actuate: Callable[[Array], Array] = np.array,
    law: str = LAW,
) -> tuple[Recording, ...]:
    """Record the stage; actuate maps the drive to the voltage at the ceramic."""
    rng, recordings = np.random.default_rng(1), []
    for name, drive in drives.items():
        history = tuple(float(actuate(np.full(1, command))[0]) for command in CYCLED)
        response = response_of(law, actuate(drive), history)
        reading = read(name, drive, response) + NOISE * rng.normal(size=len(drive))
        recordings.append(drive_recording(name, RATE_Hz, drive, HALF_STROKE_m * reading))
    return tuple(recordings)


def lagged(signal: Array, time_s: float) -> Array:
    """Return a signal behind a first-order lag."""
    pole = np.exp(-1.0 / (time_s * RATE_Hz))
    return np.asarray(lfilter([1.0 - pole], [1.0, -pole], signal, zi=[pole * signal[0]])[0])


def mean_delay_s(time_s: float) -> float:
    """Return the delay of slow motion behind a sampled lag."""
    pole = np.exp(-1.0 / (time_s * RATE_Hz))
    return float(pole / (1.0 - pole) / RATE_Hz)


def slewed(drive: Array, step: float) -> Array:
    reached = drive.copy()
    for k in range(1, len(drive)):
        reached[k] = reached[k - 1] + np.clip(drive[k] - reached[k - 1], -step, step)
    return reached


def ringing(_: str, __: Array, response: Array) -> Array:
    """Pass through a mode of 40 Hz and quality 15, integrated eight times as finely."""
    w, time_s = 2.0 * np.pi * 40.0, np.arange(8 * len(TIME_s)) / (8.0 * RATE_Hz)
    fine = np.interp(time_s, TIME_s, response) - response[0]
    return np.asarray(response[0] + lsim(([w**2], [1.0, w / 15.0, w**2]), fine, time_s)[1][::8])


def creeping(_: str, __: Array, response: Array) -> Array:
    times_s = np.geomspace(0.02, 60.0, 12)
    return response + 0.01 * sum(lagged(response, time_s) for time_s in times_s)


def sensitive(name: str, _: Array, response: Array) -> Array:
    return response * np.where((TIME_s >= 2.5) | (name == "waves"), 1.03, 1.0)


def lagged_hysteresis(_: str, drive: Array, response: Array) -> Array:
    return 0.4 * drive + lagged(response - 0.4 * drive, 2e-3)


def coupled_recordings() -> tuple[Recording, ...]:
    """Return recordings with a cross coupling of 7.5 nm/V from another axis."""
    coupled_displacement = 0.02 * np.sin(2.3 * TIME_s + 1.0) + 0.0075 * np.sin(12.1 * TIME_s)
    return tuple(
        map(with_another_axis, recorded(ONE_SPEED, lambda _, __, x: x + coupled_displacement))
    )


def clipped_at(highest: float, law: str = LAW) -> tuple[Recording, ...]:
    """Return recordings of a stage whose amplifier clips at a fraction of the half range."""
    return recorded(ONE_SPEED, actuate=lambda drive: np.minimum(drive, highest), law=law)


STAGES: Mapping[str, Callable[[], tuple[Recording, ...]]] = {
    "amplifier_saturation": lambda: clipped_at(0.8),
    "creep": lambda: recorded(ONE_SPEED, creeping),
    "cross_coupling": coupled_recordings,
    "delay": lambda: recorded(SPEEDS, lambda _, __, x: np.interp(TIME_s - 1.3e-3, TIME_s, x)),
    "gain_change": lambda: recorded(ONE_SPEED, sensitive),
    "lag": lambda: recorded(WITH_SLOW, lambda _, __, x: lagged(x, 3e-3)),
    "mains_interference": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * 50.0 * TIME_s + len(_))
    ),
    "rate_dependence": lambda: recorded(TWO_SPEEDS, lagged_hysteresis),
    # Loop shape partly absorbs a filter behind friction, so the gain is stated for plays.
    "resonance": lambda: recorded(WITH_TONES, ringing, law="sum of plays"),
    "sensor_periodic_error": lambda: recorded(
        ONE_SPEED, lambda _, __, x: x + 4e-3 * np.sin(2.0 * np.pi * x / 0.06 + 0.7)
    ),
    # Friction behind a slew limit resembles a lag of the whole stage. The fast recording moves
    # against its drive like a butterfly; the slow one shows that the ceramic does not.
    "slew_limit": lambda: recorded(
        {name: WITH_SLOW[name] for name in ("fast", "slow")},
        actuate=lambda drive: slewed(drive, SLEW_LIMIT_V_per_s / (5.0 * RATE_Hz)),
        law="sum of plays",
    ),
}


# With fewer rows a lag is named rate dependence, and a periodic error has a second harmonic.
ROWS = {"lag": 12_000, "sensor_periodic_error": 6000}
# Extended together with loop shape. Periodic error: test_loop_shape.py.
WITH_LOOP_SHAPE = ("delay",)


@cache
def diagnosed_stage(name: str) -> tuple[Diagnosis, AxisModel]:
    """Return the diagnosis of a stage and its extended model."""
    with pytest.MonkeyPatch.context() as patch:
        fit_one_order(patch)
        fit_few_rows(patch, ROWS.get(name, 3000))
        if name not in WITH_LOOP_SHAPE:
            fit_plays_alone(patch)
        diagnosis = diagnose(STAGES[name]())
    assert diagnosis.model is not None
    return diagnosis, diagnosis.model


def extension_of(name: str) -> Any:
    (extension,) = diagnosed_stage(name)[1].extensions
    return extension


@pytest.mark.parametrize("name", STAGES)
def test_only_the_hidden_effect_is_named_with_its_interval_and_gain(name):
    diagnosis, extended = diagnosed_stage(name)
    assert causes(diagnosis) == (name,)
    finding = finding_of(diagnosis, name)
    assert finding.size.ci95[0] < finding.size.value < finding.size.ci95[1]
    assert finding.held_out_gain > 0.0
    assert finding.held_out_rms_after_m < finding.held_out_rms_before_m
    assert extended.quality.held_out_rms_m < diagnosis.baseline.rms_m
    if name not in ("delay", "lag"):  # these change the lag of the model
        assert extension_of(name)


@pytest.mark.usefixtures("plays_alone", "one_order")
def test_a_healthy_stage_has_no_findings_and_a_bound_on_every_effect():
    """Bouc-Wen ceramic with loop shape: test_budget.py."""
    diagnosis = diagnose(recorded(TWO_SPEEDS))
    assert causes(diagnosis) == ()
    listed = {absent.effect for absent in diagnosis.not_detected} | set(diagnosis.names)
    assert listed == {effect.name for effect in EFFECTS}
    assert 0.0 < diagnosis.unexplained.p_value <= 1.0
    for absent in diagnosis.not_detected:
        assert len(absent.reason) > 20
        if absent.upper_bound_m is not None and absent.detection_limit_m is not None:
            assert 0.0 < absent.upper_bound_m <= absent.detection_limit_m


@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_a_diagnosis_is_independent_of_threads_and_survives_its_file():
    messages: set[str] = set()
    diagnosis = diagnosed_stage("creep")[0]
    threaded = diagnose(STAGES["creep"](), threads=3, progress=messages.add)
    written = write_diagnosis(diagnosis)
    assert write_diagnosis(threaded) == written
    assert read_diagnoses(written)[0] == diagnosis
    content = unseal(written, SCHEMA, "diagnosis.json")
    assert content["final"]["held_out_rms_m"] == diagnosis.final.rms_m
    assert {"testing lag", "comparing creep with confounded effects"} <= messages


def test_a_clipping_amplifier_has_its_voltage_limit_on_the_clipped_side_only():
    extension = extension_of("amplifier_saturation")
    assert extension.high_V == pytest.approx(9.0, abs=0.03)
    assert extension.low_V is None


def test_creep_has_its_share_of_a_step_per_decade():
    extension = extension_of("creep")
    decade = np.log10(extension.time_s[1] / extension.time_s[0])
    assert np.mean(extension.share) / decade == pytest.approx(
        0.01 * 11.0 / np.log10(3000.0), rel=0.1
    )


def test_cross_coupling_is_stated_per_volt_of_the_other_axis():
    extension = extension_of("cross_coupling")
    assert extension.axis == "y"
    assert extension.gain_m_per_V == pytest.approx(0.02 * HALF_STROKE_m / 40.0, rel=0.15)


@pytest.mark.parametrize(("name", "late_s"), [("delay", 1.3e-3), ("lag", mean_delay_s(3e-3))])
def test_a_delay_or_lag_has_its_time(name, late_s):
    _, extended = diagnosed_stage(name)
    assert not extended.extensions  # the lag of the model includes it
    assert extended.lag.time_s == pytest.approx(late_s, rel=0.1)


def test_a_gain_change_has_its_instant_and_ratio():
    extension = extension_of("gain_change")
    assert (extension.recording, extension.later) == ("loops", ("waves",))
    assert extension.instant_s == pytest.approx(2.5, abs=2.0 / RATE_Hz)
    assert extension.ratio == pytest.approx(1.03, abs=3.0 * extension.std[0])
    assert extension.std[0] < 2e-3


def test_a_mode_has_its_frequency_and_quality():
    extension = extension_of("resonance")
    assert extension.frequency_Hz == pytest.approx(40.0, rel=1e-3)
    assert extension.quality == pytest.approx(15.0, rel=0.01)
    assert extension.participation == pytest.approx(1.0, abs=0.01)


def test_hum_has_its_amplitude_and_phase_in_every_recording():
    extension = extension_of("mains_interference")
    assert extension.frequency_Hz == pytest.approx(50.0, rel=1e-4)
    assert {hum.recording for hum in extension.hums} == set(ONE_SPEED)
    for hum in extension.hums:
        phasor = complex(hum.sine_m[0], hum.cosine_m[0])
        expected = 4e-3 * HALF_STROKE_m * np.exp(1j * len(hum.recording))
        assert abs(phasor - expected) < 0.05 * abs(expected)


def test_a_steep_periodic_error_has_its_wavelength_and_amplitude():
    extension = extension_of("sensor_periodic_error")
    assert extension.wavelength_m == pytest.approx(0.06 * HALF_STROKE_m, rel=3e-3)
    assert extension.amplitude_m[0] == pytest.approx(4e-3 * HALF_STROKE_m, rel=0.03)
    assert extension.amplitude_m[1] < 0.02 * extension.amplitude_m[0]


def test_a_slew_limit_is_stated_in_volts_per_second():
    size = finding_of(diagnosed_stage("slew_limit")[0], "slew_limit").size
    assert size.value == pytest.approx(SLEW_LIMIT_V_per_s, rel=2e-3)
    assert size.ci95[0] < SLEW_LIMIT_V_per_s < size.ci95[1]
    limit_V_per_s = extension_of("slew_limit").limit_V_per_s
    assert limit_V_per_s == pytest.approx(SLEW_LIMIT_V_per_s, rel=0.02)


@pytest.mark.usefixtures("plays_alone", "few_rows")
def test_clipping_of_half_the_range_is_found_with_its_initial_state():
    """Half of the command is cut off, also in the turns before the recording."""
    recordings = clipped_at(0.0, law="sum of plays")
    diagnosis = diagnose(recordings)
    (finding,) = effects_of(diagnosis)
    assert finding.effect == "amplifier_saturation"
    top_V = max(float(recording.voltage_V().max()) for recording in recordings)
    cut_percent = 100.0 * (top_V - 5.0) / top_V
    assert finding.size.ci95[0] < cut_percent < finding.size.ci95[1]
    assert diagnosis.final.rms_m < 1.5 * diagnosis.noise_floor_rms_m


@pytest.mark.usefixtures("plays_alone", "one_order", "few_rows")
def test_a_stage_without_a_known_history_was_cycled_over_its_range():
    recordings = recorded(ONE_SPEED, sensitive, law="sum of plays")
    model, recording = fit(recordings).axes["x"], recordings[0]
    cycled = effect_named("initial_state").without(model, recording)
    assert [start.recording for start in cycled.starts].count(recording.name) == 1
    (start,) = [start for start in cycled.starts if start.recording == recording.name]
    first_V = float(recording.voltage_V()[start.first])
    low_V, high_V = model.voltage_V
    # Up to the top and down to the first value: each play moved along or stayed at the top.
    threshold_V = model.hysteresis.plays.threshold
    from_centre = np.array([low_V, high_V, first_V]) - model.hysteresis.voltage_offset_V
    states_V, expected_V = play_columns(from_centre, threshold_V, np.zeros(len(threshold_V)))
    assert len(states_V) == 3
    np.testing.assert_allclose(start.memory_V, expected_V, atol=1e-9)
