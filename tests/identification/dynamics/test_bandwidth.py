"""A stated bandwidth of 630 Hz is a pole or a resonance, decided by phase and peak."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.bandwidth import BandwidthVerdict, decide_bandwidth, unfitted
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.operators.linear import ContinuousSystem, cascade, first_order, resonance, sample
from tests.identification.dynamics.stage import (
    AMPLIFIER,
    DECLARATION,
    RATE_HZ,
    first_response,
    lines_between,
    record,
)
from tests.identification.dynamics.test_axis_dynamics import recorded
from tests.reports.known_stage import axis_model

NO_DELAY = (0.0, 0.0)


def response_of(
    rng: np.random.Generator, system: ContinuousSystem, sign: int = 1
) -> FrequencyResponse:
    """Return the response of a stage to a multisine up to 4 kHz behind hold and amplifier."""
    measured = first_response(record(rng, noise_m=2e-9))
    sampled = sample(cascade(AMPLIFIER.system(), system), RATE_HZ)
    return replace(
        measured, response=1e-6 * sign * sampled.response(measured.frequency_Hz)[:, 0, 0]
    )


def with_delay(system: ContinuousSystem, delay_s: float) -> ContinuousSystem:
    return replace(system, delay_s=delay_s)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("stated_Hz", [None, 630.0])
def test_a_pole_is_identified_as_a_pole(rng, sign, stated_Hz):
    measured = response_of(rng, first_order(630), sign)
    verdict = decide_bandwidth(measured, DECLARATION, delay_s=NO_DELAY, stated_Hz=stated_Hz)
    assert verdict.kind == "first_order"
    assert verdict.fallen_Hz == pytest.approx(630, rel=0.01)
    assert verdict.phase_interval_deg is not None
    assert np.mean(verdict.phase_interval_deg) == pytest.approx(-45, abs=1.0)
    assert ("lab.toml states" in verdict.text) == (stated_Hz is not None)


@pytest.mark.parametrize("damping", [0.02, 0.1, 0.4, 0.7])
def test_a_mode_is_identified_as_a_resonance_with_or_without_a_peak(rng, damping):
    verdict = decide_bandwidth(
        response_of(rng, resonance(630, damping)), DECLARATION, delay_s=NO_DELAY
    )
    assert verdict.kind == "resonance"
    assert verdict.phase_interval_deg[1] < -88.0


def test_with_an_unknown_delay_only_a_peak_is_decisive(rng):
    """A pole with a delay of 140 us has the phase of a mode; no delay produces a peak."""
    pole = response_of(rng, with_delay(first_order(630), 140e-6))
    assert decide_bandwidth(pole, DECLARATION).kind == "undecided"
    assert decide_bandwidth(pole, DECLARATION, delay_s=(130e-6, 150e-6)).kind == "first_order"
    assert decide_bandwidth(response_of(rng, resonance(630, 0.7)), DECLARATION).kind == "undecided"
    assert decide_bandwidth(response_of(rng, resonance(630, 0.1)), DECLARATION).kind == "resonance"


@pytest.mark.parametrize("system", [first_order(630), resonance(630, 0.05), resonance(630, 0.7)])
def test_a_response_without_static_gain_or_roll_off_is_undecided(rng, system):
    short = lines_between(response_of(rng, system), 30.0, 200.0)
    verdict = decide_bandwidth(short, DECLARATION, delay_s=NO_DELAY, stated_Hz=630.0)
    assert verdict.kind == "undecided"
    assert verdict.fallen_Hz is None
    assert "lab.toml states a bandwidth of 630 Hz" in verdict.text
    without_rest = lines_between(response_of(rng, system), 500.0, 4000.0)
    assert decide_bandwidth(without_rest, DECLARATION, delay_s=NO_DELAY).kind == "undecided"


def test_a_stated_bandwidth_beyond_the_recordings_is_undecided():
    recording = recorded(5.0 + np.sin(np.arange(5000) / 500.0), np.random.default_rng(41))
    axis = with_dynamics(axis_model(), [recording], stated_Hz=630.0)
    assert axis.bandwidth.kind == "undecided"
    assert axis.bandwidth.text in axis.dynamics_remarks


def slewed(frequency_Hz: np.ndarray, limited_from_Hz: float) -> np.ndarray:
    """Return the fundamental of slew-limited sines of unit amplitude, one for each frequency."""
    steps = 400  # per period
    max_step = 2.0 * np.pi / steps * limited_from_Hz / frequency_Hz
    output, fundamental = np.zeros_like(frequency_Hz), np.zeros(len(frequency_Hz), dtype=complex)
    for k in range(4 * steps):
        phase = 2.0 * np.pi * k / steps
        output = output + np.clip(np.sin(phase) - output, -max_step, max_step)
        if k >= 3 * steps:  # steady state
            fundamental += 2j / steps * output * np.exp(-1j * phase)
    return fundamental


def test_a_slew_limit_is_not_a_pole(rng):
    """At -3 dB its phase is -29 degrees; that of a pole is -45 degrees."""
    for delay_s in ((0.0, 0.0), (0.0, np.inf)):
        measured = response_of(rng, first_order(1e6))
        f = measured.frequency_Hz
        limited = replace(measured, response=measured.response * slewed(f, 300.0))
        verdict = decide_bandwidth(limited, DECLARATION, delay_s=delay_s)
        assert verdict.kind == "undecided"
        assert verdict.phase_interval_deg[0] == pytest.approx(-29.0, abs=3.0)


def test_a_peak_at_the_end_of_a_response_is_a_resonance_there_or_above():
    peak = BandwidthVerdict(
        kind="resonance", stated_Hz=None, peak_ratio=2.4, peak_Hz=125.0, highest_Hz=127.0, text=""
    )
    at_the_end = unfitted(peak, "chirp.csv", "a reason").text
    assert "at 125 Hz or above, where its response ends" in at_the_end
    assert "to at least 254 Hz" in at_the_end
    inside = unfitted(replace(peak, peak_Hz=60.0), "chirp.csv", "a reason").text
    assert "near 60.0 Hz" in inside
