"""A stated bandwidth of 630 Hz: pole or resonance, said with phase and peak."""

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

KNOWN = (0.0, 0.0)


def seen(rng: np.random.Generator, system: ContinuousSystem, sign: int = 1) -> FrequencyResponse:
    """What a multisine up to 4 kHz shows of a stage behind hold and declared amplifier."""
    measured = first_response(record(rng, noise_m=2e-9))
    whole = sample(cascade(AMPLIFIER.system(), system), RATE_HZ)
    return replace(measured, response=1e-6 * sign * whole.response(measured.frequency_Hz)[:, 0, 0])


def late(system: ContinuousSystem, delay_s: float) -> ContinuousSystem:
    return replace(system, delay_s=delay_s)


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("stated_Hz", [None, 630.0])
def test_a_pole_is_called_a_pole(rng, sign, stated_Hz):
    measured = seen(rng, first_order(630), sign)
    verdict = decide_bandwidth(measured, DECLARATION, delay_s=KNOWN, stated_Hz=stated_Hz)
    assert verdict.kind == "first_order"
    assert verdict.fallen_Hz == pytest.approx(630, rel=0.01)
    assert verdict.phase_interval_deg is not None
    assert np.mean(verdict.phase_interval_deg) == pytest.approx(-45, abs=1.0)
    assert ("lab.toml states" in verdict.text) == (stated_Hz is not None)


@pytest.mark.parametrize("damping", [0.02, 0.1, 0.4, 0.7])
def test_a_mode_is_called_a_resonance_with_or_without_a_peak(rng, damping):
    verdict = decide_bandwidth(seen(rng, resonance(630, damping)), DECLARATION, delay_s=KNOWN)
    assert verdict.kind == "resonance"
    assert verdict.phase_interval_deg is not None
    assert verdict.phase_interval_deg[1] < -88.0


def test_an_unknown_delay_leaves_a_steep_phase_undecided_and_a_peak_decisive(rng):
    """A pole with 140 us has the phase of a mode; a peak no delay can make."""
    pole = seen(rng, late(first_order(630), 140e-6))
    assert decide_bandwidth(pole, DECLARATION).kind == "undecided"
    assert decide_bandwidth(pole, DECLARATION, delay_s=(130e-6, 150e-6)).kind == "first_order"
    assert decide_bandwidth(seen(rng, resonance(630, 0.7)), DECLARATION).kind == "undecided"
    assert decide_bandwidth(seen(rng, resonance(630, 0.1)), DECLARATION).kind == "resonance"


@pytest.mark.parametrize("system", [first_order(630), resonance(630, 0.05), resonance(630, 0.7)])
def test_lines_that_show_no_gain_at_rest_or_end_before_it_falls_decide_nothing(rng, system):
    short = lines_between(seen(rng, system), 30.0, 200.0)
    verdict = decide_bandwidth(short, DECLARATION, delay_s=KNOWN, stated_Hz=630.0)
    assert verdict.kind == "undecided"
    assert verdict.fallen_Hz is None
    assert "lab.toml states a bandwidth of 630 Hz" in verdict.text
    without_rest = lines_between(seen(rng, system), 500.0, 4000.0)
    assert decide_bandwidth(without_rest, DECLARATION, delay_s=KNOWN).kind == "undecided"


def test_a_stated_bandwidth_no_recording_reaches_is_said_to_be_open():
    slow = recorded(5.0 + np.sin(np.arange(5000) / 500.0), np.random.default_rng(41))
    found = with_dynamics(axis_model(), [slow], stated_Hz=630.0)
    assert found.bandwidth is not None
    assert found.bandwidth.kind == "undecided"
    assert found.bandwidth.text in found.dynamics_remarks


def slewed(frequency_Hz: np.ndarray, limited_from_Hz: float) -> np.ndarray:
    """Fundamental that a slew limit leaves of sines of one amplitude, one for each frequency."""
    steps = 400  # of a period
    most = 2.0 * np.pi / steps * limited_from_Hz / frequency_Hz
    output, left = np.zeros_like(frequency_Hz), np.zeros(len(frequency_Hz), dtype=complex)
    for k in range(4 * steps):
        turn = 2.0 * np.pi * k / steps
        output = output + np.clip(np.sin(turn) - output, -most, most)
        if k >= 3 * steps:  # settled
            left += 2j / steps * output * np.exp(-1j * turn)
    return left


def test_a_slew_limit_is_no_pole(rng):
    """It turns 29 degrees where a pole turns 45: by 3 dB the gain falls behind both."""
    for delay_s in ((0.0, 0.0), (0.0, np.inf)):
        measured = seen(rng, first_order(1e6))
        f = measured.frequency_Hz
        limited = replace(measured, response=measured.response * slewed(f, 300.0))
        verdict = decide_bandwidth(limited, DECLARATION, delay_s=delay_s)
        assert verdict.kind == "undecided"
        assert verdict.phase_interval_deg is not None
        assert verdict.phase_interval_deg[0] == pytest.approx(-29.0, abs=3.0)


def test_a_gain_that_peaks_where_the_response_ends_is_a_resonance_there_or_above():
    peak = BandwidthVerdict(
        kind="resonance", stated_Hz=None, peak_ratio=2.4, peak_Hz=125.0, highest_Hz=127.0, text=""
    )
    at_the_end = unfitted(peak, "chirp.csv", "a reason").text
    assert "at 125 Hz or above, where its response ends" in at_the_end
    assert "to at least 254 Hz" in at_the_end
    inside = unfitted(replace(peak, peak_Hz=60.0), "chirp.csv", "a reason").text
    assert "near 60.0 Hz" in inside
