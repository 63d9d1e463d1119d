"""A PID with notches: its computation, its polynomials, its margins, and its files."""

import csv
import io
from collections import namedtuple
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import Template, margins, sensitivities
from piezoid.design.specification import default_specification
from piezoid.errors import DesignError
from piezoid.formatting import with_unit
from piezoid.targets.pid import Notch, pid_law, tuned_pid
from piezoid.targets.pid_files import pid_files, pid_of
from piezoid.targets.target_inputs import ControllerHardware
from piezoid.verification.closed_loop import run_law
from piezoid.verification.plant import CustomResponse
from tests.targets.known_inputs import BLANK, chain, exported, family
from tests.verification.rig import GAIN_m_per_V, RATE_Hz, lateral

SOME = replace(
    BLANK,
    proportional_V_per_m=2e4,
    integral_V_per_m_s=5e7,
    derivative_V_s_per_m=3.0,
    notches=(
        Notch(frequency_Hz=630.0, depth=0.05, width=0.7),
        Notch(frequency_Hz=2e3, depth=0.1, width=1.0),
    ),
)


Tuned = namedtuple("Tuned", "pid margins")


def tuned(plants=None, notches=1, blank=BLANK, delay_margin_s=5e-5, templates=()):
    plants = plants or family()
    specification = default_specification(
        plants, voltage_min_V=0.0, voltage_max_V=10.0, sensor_noise_rms=0.0, disturbance_rms=1e-8
    )
    specification = replace(specification, delay_margin_s=delay_margin_s, templates=templates)
    return Tuned(*tuned_pid("x", plants, blank, notches=notches, specification=specification))


def test_a_mode_that_no_recording_shows_limits_the_box_as_it_limits_the_exported_loop():
    unseen_peak, from_Hz = 30.0, 2e3
    limit = Template(
        name="control effort beyond what is known",
        function="Sup",
        frequency_Hz=[from_Hz, RATE_Hz / 2],
        upper_dB=2 * [-20.0 * np.log10(unseen_peak * GAIN_m_per_V)],
    )
    free, held = tuned(notches=0), tuned(notches=0, templates=(limit,))
    place_Hz = np.geomspace(from_Hz, 0.499 * RATE_Hz, 500)
    for found, stays in ((free, False), (held, True)):
        R, S = found.pid.polynomials()
        efforts = [np.abs(sensitivities(m, R, S, place_Hz).Sup).max() for m in family().members]
        assert (max(efforts) * unseen_peak * GAIN_m_per_V < 1.0) == stays
    assert held.pid.integral_V_per_m_s > 0.05 * free.pid.integral_V_per_m_s


def answers(pid, errors_m):
    box = pid_law(pid)
    return np.array([box(error, 0.0) for error in errors_m])


def test_the_box_computes_its_own_fraction(rng):
    errors_m = 1e-7 * rng.standard_normal(500)
    errors_m[0] = 0.0  # a box begins without a derivative
    R, S = SOME.polynomials()
    np.testing.assert_allclose(answers(SOME, errors_m), lfilter(R, S, errors_m), atol=1e-12)


def test_a_notch_takes_its_frequency_and_leaves_the_rest():
    b, a = Notch(frequency_Hz=630.0, depth=0.05, width=0.5).section(RATE_Hz)
    q = np.exp(-2j * np.pi * np.array([1.0, 630.0, 9e3]) / RATE_Hz)
    left = np.abs(np.polyval(b[::-1], q) / np.polyval(a[::-1], q))
    np.testing.assert_allclose(left, [1.0, 0.1, 1.0], atol=2e-3)


def test_limits_hold_and_the_integral_comes_back_from_them_at_once():
    pid = replace(SOME, notches=(), derivative_V_s_per_m=0.0, slew_V_per_s=1e4, lsb_V=0.01)
    out_V = answers(pid, np.r_[np.full(4000, 1e-4), np.full(400, -1e-6)])
    assert np.abs(np.diff(out_V)).max() <= 1e4 / RATE_Hz + 0.01
    assert out_V.max() == 10.0
    np.testing.assert_allclose(out_V / 0.01, np.round(out_V / 0.01), atol=1e-9)
    assert out_V[4000] < 10.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_all_plants_keep_their_margins_and_no_larger_gain_would(sign):
    found = tuned(family(sign))
    assert len(found.margins) == 5
    assert min(m.modulus_margin for m in found.margins) >= 0.5
    more = found.pid.scaled(1.1).polynomials()
    again = [margins(member, *more) for member in family(sign).members]
    assert min(m.modulus_margin for m in again) < 0.5
    assert np.sign(found.pid.integral_V_per_m_s) == sign


def test_a_notch_on_the_mode_is_worth_most_of_the_rejection():
    without, with_one = (tuned(notches=n).pid.integral_V_per_m_s for n in (0, 1))
    assert with_one > 10 * without
    assert tuned(notches=1).pid.notches[0].frequency_Hz == pytest.approx(630.0, rel=1e-3)


def test_an_asked_delay_margin_is_kept():
    found = tuned(delay_margin_s=5e-4)
    assert min(m.delay_margin_s for m in found.margins if m.delay_margin_s) >= 5e-4
    assert found.pid.integral_V_per_m_s < tuned().pid.integral_V_per_m_s


def test_what_no_box_can_hold_is_refused_with_what_would_fit():
    both = PlantFamily(
        members=(plant_from_chain(chain()), replace(plant_from_chain(chain(-1.0)), label="other"))
    )
    with pytest.raises(DesignError, match=r"no PID with 1 notches.*--target waveform"):
        tuned(both)


def test_the_box_in_the_loop_rejects_what_its_fraction_says():
    """Signs included: a disturbance of 40 Hz on a plant without hysteresis."""
    pid = tuned().pid
    plant = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v),
        noise_rms=0.0,
        delay_s=0.0,
    )
    time_s = np.arange(20000) / RATE_Hz
    wave_m = 1e-7 * np.sin(2 * np.pi * 40.0 * time_s)
    moved = run_law(
        plant,
        pid_law(pid),
        np.zeros(20000),
        rng=np.random.default_rng(0),
        disturbance=wave_m,
    )
    tone = np.exp(-2j * np.pi * 40.0 * time_s[10000:])
    left = abs(np.mean(moved.position[10000:] * tone) / np.mean(wave_m[10000:] * tone))
    said = sensitivities(family().nominal, *pid.polynomials(), np.array([40.0])).Syp[0]
    assert left == pytest.approx(abs(said), rel=0.03)


@cache
def files():
    return pid_files(exported())


@cache
def searched():
    return pid_of(exported(), exported().lateral[0])


def test_files_hold_settings_and_sections_and_the_loss():
    made, notes = files()
    pid, _, errors_m = searched()
    rows = list(csv.DictReader(io.StringIO(made["settings.csv"].decode())))
    settings = {row["setting"]: (float(row["value"]), row["unit"]) for row in rows}
    assert settings["integral"] == (pid.integral_V_per_m_s, "V/(m s)")
    rows = errors_m.values()
    exported_m, pid_m = (max(row[name] for row in rows) for name in ("exported", "pid"))
    assert (
        f"errs by {with_unit(pid_m, 'm')} rms instead of {with_unit(exported_m, 'm')}" in notes[0]
    )
    readme = made["README.md"].decode()
    assert "| draw 2 |" in readme


@pytest.mark.parametrize("update_Hz", [None, 122189.638])
def test_sections_answer_as_the_controller_at_their_rate(update_Hz):
    hardware = ControllerHardware(update_Hz=update_Hz)
    made, _ = pid_files(replace(exported(), hardware=hardware)) if update_Hz else files()
    pid, _, _ = searched()
    frequency_Hz = np.geomspace(1.0, 2e3, 40)
    q = np.exp(-2j * np.pi * frequency_Hz / (update_Hz or RATE_Hz))
    response = np.ones(40, dtype=complex)
    for row in csv.DictReader(io.StringIO(made["sections.csv"].decode())):
        b0, b1, b2, a1, a2 = (float(row[name]) for name in ("b0", "b1", "b2", "a1", "a2"))
        response *= (b0 + b1 * q + b2 * q**2) / (1.0 + a1 * q + a2 * q**2)
    R, S = pid.polynomials()
    at = np.exp(-2j * np.pi * frequency_Hz / RATE_Hz)
    reference = np.polyval(R[::-1], at) / np.polyval(S[::-1], at)
    tolerance = 1e-9 if update_Hz is None else 0.3  # holds of two rates differ towards Nyquist
    assert np.abs(response / reference - 1.0).max() < tolerance


def test_a_slew_limit_is_simulated():
    axis = exported().lateral[0]
    limited = replace(exported(), hardware=ControllerHardware(slew_V_per_s=50.0))
    (slow, _, slow_m), (_, _, free_m) = pid_of(limited, axis), searched()
    assert slow.slew_V_per_s == 50.0
    label = next(iter(free_m))
    assert slow_m[label]["pid"] > 2 * free_m[label]["pid"]
