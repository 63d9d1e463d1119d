"""A measured response gives modes, delay and creep slope; inconsistent data are not used."""

from functools import cache

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.axis_dynamics import with_dynamics
from piezoid.identification.dynamics.modal import Filter
from piezoid.identification.dynamics.response_fit import fit_response
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.operators.play import play_columns
from piezoid.records.frequency_response import FrequencyResponseRecord, ResponsePath
from piezoid.records.recording import Recording
from tests.identification.hysteresis.stages import recording
from tests.records.responses import noisy, response

pytestmark = pytest.mark.usefixtures("one_order")

FREQUENCY_Hz = np.geomspace(1.0, 5000.0, 400)
AMPLIFIER, SENSOR = (
    Filter(name=n, frequency_Hz=f) for n, f in (("amplifier", 4e3), ("sensor", 8.5e3))
)
STAGES = {
    "quality 5": ((1500.0, 5.0, 1.0),),
    "quality 100": ((150.0, 100.0, 1.0),),
    "two modes": ((300.0, 80.0, 1.0), (900.0, 20.0, 0.3)),
    "out of phase": ((500.0, 40.0, 1.0), (3000.0, 30.0, -0.4)),
}


def record(
    values: ComplexArray,
    coherence: Array | None = None,
    frequency_Hz: Array = FREQUENCY_Hz,
    includes: tuple[str, ...] = ("amplifier", "sensor"),
) -> FrequencyResponseRecord:
    path = ResponsePath(output="x", drive="x", response_m_per_V=values, coherence=coherence)
    return FrequencyResponseRecord(
        name="response.csv",
        digest="0",
        frequency_Hz=frequency_Hz,
        paths=(path,),
        includes=includes,
    )


@pytest.mark.parametrize("modes", STAGES.values(), ids=STAGES)
def test_modes_delay_and_creep_are_identified(modes, rng):
    exact = response(FREQUENCY_Hz, modes, delay_s=2e-4, slope_dB=-0.15)
    fit = fit_response(record(noisy(rng, exact, 0.005)), "x", ())
    assert fit.is_determined
    dynamics = fit.dynamics
    expected_Hz, quality, share = np.array(modes).T
    np.testing.assert_allclose(dynamics.mode_frequency_Hz, expected_Hz, rtol=1e-3)
    np.testing.assert_allclose(0.5 / dynamics.mode_damping, quality, rtol=0.03)
    np.testing.assert_allclose(dynamics.mode_gain_m_per_V, 2e-7 * share, rtol=0.03)
    assert dynamics.delay_s == pytest.approx(2e-4, abs=2e-6)
    assert fit.slow.falls
    assert fit.slow.slope_dB == pytest.approx(-0.15, abs=0.03)


def test_incoherent_lines_are_excluded(rng):
    exact = response(FREQUENCY_Hz)
    coherence, values = np.full(len(exact), 0.999), noisy(rng, exact, 0.003)
    is_incoherent = (FREQUENCY_Hz > 90.0) & (FREQUENCY_Hz < 140.0)
    coherence[is_incoherent], values[is_incoherent] = 0.2, 5.0 * values[is_incoherent][::-1] * 1j
    fit = fit_response(record(values, coherence), "x", ())
    assert fit.measured.is_rejected.tolist() == is_incoherent.tolist()
    assert fit.dynamics.mode_frequency_Hz == pytest.approx([812.0], rel=1e-3)
    with pytest.raises(ExcitationError, match="0 of 400 lines of axis x are coherent"):
        fit_response(record(values, np.full(len(exact), 0.1)), "x", ())


def test_a_mains_line_is_excluded(rng):
    values = noisy(rng, response(FREQUENCY_Hz), 0.002)
    line = int(np.argmin(np.abs(FREQUENCY_Hz - 50.0)))
    values[line] *= 1.4
    fit = fit_response(record(values), "x", ())
    assert np.flatnonzero(fit.measured.is_interference).tolist() == [line]


def test_declared_poles_are_those_in_the_path_of_the_response(rng):
    ideal = noisy(rng, response(FREQUENCY_Hz), 0.001)
    behind_sensor = ideal * SENSOR.system().response(FREQUENCY_Hz)[:, 0, 0]
    behind_both = behind_sensor * AMPLIFIER.system().response(FREQUENCY_Hz)[:, 0, 0]
    declared = (AMPLIFIER, SENSOR)
    full_path = fit_response(record(behind_both), "x", declared).dynamics
    sensor_path = fit_response(record(behind_sensor, includes=("sensor",)), "x", declared).dynamics
    for dynamics in (full_path, sensor_path):
        assert dynamics.declared == declared
        assert dynamics.delay_s == pytest.approx(1e-4, abs=1e-6)
        np.testing.assert_allclose(dynamics.response([2000.0]), full_path.response([2000.0]), 1e-3)


def test_a_response_without_a_few_modes_is_not_determined(rng):
    f = FREQUENCY_Hz[::4]
    random_response = response(f) * np.exp(1.5 * rng.standard_normal(len(f)))
    assert not fit_response(record(random_response, frequency_Hz=f), "x", ()).is_determined


@cache
def slow_axis(polarity: float) -> tuple[AxisModel, Recording]:
    """Return a sweep at one speed with 240 nm/V at large strokes, and its fitted axis."""
    rng = np.random.default_rng(2)
    time_s = np.arange(4000) / 500.0
    drive_V = 50.0 - 45.0 * np.cos(2.0 * np.pi * 0.5 * time_s) * np.interp(
        time_s, [0, 8], [1, 0.4]
    )
    plays, _ = play_columns(drive_V, np.array([4.0, 10.0, 20.0]), np.zeros(3))
    displacement_m = 2.4e-7 * (0.8 * drive_V + plays @ np.array([0.08, 0.08, 0.06]))
    displacement_m = polarity * displacement_m + 2e-9 * rng.standard_normal(len(displacement_m))
    sweep = recording(drive_V, displacement_m, "sweep.csv", 500.0)
    return estimate_axis([sweep], "x", Rig(), orders=((4, 1),)), sweep


@pytest.mark.parametrize("polarity", [1.0, -1.0])
def test_the_response_determines_the_dynamics_and_the_hysteresis_keeps_its_gain(polarity, rng):
    axis, sweep = slow_axis(polarity)
    measured = record(noisy(rng, response(FREQUENCY_Hz), 0.003))
    axis_with_dynamics = with_dynamics(axis, [sweep], response=measured)
    assert axis_with_dynamics.bandwidth.kind == "resonance"
    assert np.sign(axis_with_dynamics.dynamics.static_gain_m_per_V) == axis.polarity == polarity
    middle = 0.5 * sum(axis.hysteresis.slope_sector_m_per_V)
    assert axis_with_dynamics.response.gain_ratio == pytest.approx(2e-7 / middle, rel=0.01)
    remarks = " ".join(axis_with_dynamics.dynamics_remarks)
    assert "a mode at 812" in remarks
    assert "quality 30" in remarks
    assert "the hysteresis keeps its own gain" in remarks
    assert ("its sign is inverted" in remarks) == (polarity < 0.0)


@pytest.mark.parametrize("factor", [15.0, 1e-3])
def test_a_response_in_another_unit_is_not_used(factor, rng):
    axis, sweep = slow_axis(1.0)
    measured = record(factor * noisy(rng, response(FREQUENCY_Hz), 0.003))
    axis_with_dynamics = with_dynamics(axis, [sweep], response=measured)
    assert axis_with_dynamics.dynamics is None
    assert "response.csv is not used: its gain is" in axis_with_dynamics.dynamics_remarks[0]
    assert "Another unit, another axis" in axis_with_dynamics.dynamics_remarks[0]


def chirp_of(mode_Hz: float, rng: np.random.Generator) -> Recording:
    """Return a small chirp through a mode, about the centre of the sweep."""
    rate_Hz, seconds = 20_000.0, 3.0
    time_s = np.arange(int(rate_Hz * seconds)) / rate_Hz
    cycles = 10.0 * seconds / np.log(300.0) * (300.0 ** (time_s / seconds) - 1.0)
    drive_V = 50.0 + 0.3 * np.sin(2.0 * np.pi * cycles)
    f = np.fft.rfftfreq(len(time_s), 1.0 / rate_Hz)
    f[0] = 1e-3
    G = response(f, ((mode_Hz, 30.0, 1.0),), gain_m_per_V=1.9e-7)
    displacement_m = np.fft.irfft(G * np.fft.rfft(drive_V - 50.0), len(time_s)) + 1.2e-5
    displacement_m += 1e-10 * rng.standard_normal(len(displacement_m))
    return recording(drive_V, displacement_m, "chirp.csv", rate_Hz)


def test_a_response_that_contradicts_a_recording_is_not_used(rng):
    axis, sweep = slow_axis(1.0)
    measured = record(noisy(rng, response(FREQUENCY_Hz), 0.003))
    contradicted = with_dynamics(axis, [sweep, chirp_of(430.0, rng)], response=measured)
    assert contradicted.response is None
    assert (
        "chirp.csv has a mode at 430 Hz, where the response has none"
        in contradicted.dynamics_remarks[0]
    )
    confirmed = with_dynamics(axis, [sweep, chirp_of(812.0, rng)], response=measured)
    assert confirmed.response is not None
    assert "chirp.csv shows the same mode" in confirmed.dynamics_remarks[0]
