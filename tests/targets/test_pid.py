"""A PID with notches: computation, polynomials, margins, files."""

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
from piezoid.targets.pid import Notch, pid_files, pid_law, pid_of, tuned_pid
from piezoid.targets.target_inputs import ControllerHardware
from piezoid.verification.closed_loop import run_law
from piezoid.verification.plant import CustomResponse
from tests.targets.known_inputs import BLANK, chain, csv_rows, exported, family
from tests.verification.rig import GAIN_m_per_V, RATE_Hz, lateral

EXAMPLE = replace(
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


def tune(plants=None, notches=1, blank=BLANK, delay_margin_s=5e-5, templates=()):
    plants = plants or family()
    specification = default_specification(
        plants, voltage_min_V=0.0, voltage_max_V=10.0, sensor_noise_rms=0.0, disturbance_rms=1e-8
    )
    specification = replace(specification, delay_margin_s=delay_margin_s, templates=templates)
    return Tuned(*tuned_pid("x", plants, blank, notches=notches, specification=specification))


def test_an_unrecorded_mode_limits_the_gain_of_a_pid():
    unseen_peak, from_Hz = 30.0, 2e3
    limit = Template(
        name="control effort beyond what is known",
        function="Sup",
        frequency_Hz=[from_Hz, RATE_Hz / 2],
        upper_dB=2 * [-20.0 * np.log10(unseen_peak * GAIN_m_per_V)],
    )
    unlimited, limited = tune(notches=0), tune(notches=0, templates=(limit,))
    frequency_Hz = np.geomspace(from_Hz, 0.499 * RATE_Hz, 500)
    for result, is_limited in ((unlimited, False), (limited, True)):
        R, S = result.pid.polynomials()
        efforts = [
            np.abs(sensitivities(m, R, S, frequency_Hz).Sup).max() for m in family().members
        ]
        assert (max(efforts) * unseen_peak * GAIN_m_per_V < 1.0) == is_limited
    assert limited.pid.integral_V_per_m_s > 0.05 * unlimited.pid.integral_V_per_m_s


def outputs(pid, errors_m):
    law = pid_law(pid)
    return np.array([law(error, 0.0) for error in errors_m])


def test_the_pid_law_computes_its_fraction_and_a_notch_its_frequency(rng):
    errors_m = 1e-7 * rng.standard_normal(500)
    errors_m[0] = 0.0  # a controller starts without a derivative
    R, S = EXAMPLE.polynomials()
    np.testing.assert_allclose(outputs(EXAMPLE, errors_m), lfilter(R, S, errors_m), atol=1e-12)
    b, a = Notch(frequency_Hz=630.0, depth=0.05, width=0.5).section(RATE_Hz)
    q = np.exp(-2j * np.pi * np.array([1.0, 630.0, 9e3]) / RATE_Hz)
    gain = np.abs(np.polyval(b[::-1], q) / np.polyval(a[::-1], q))
    np.testing.assert_allclose(gain, [1.0, 0.1, 1.0], atol=2e-3)


def test_limits_hold_without_integrator_windup():
    pid = replace(EXAMPLE, notches=(), derivative_V_s_per_m=0.0, slew_V_per_s=1e4, lsb_V=0.01)
    output_V = outputs(pid, np.r_[np.full(4000, 1e-4), np.full(400, -1e-6)])
    assert np.abs(np.diff(output_V)).max() <= 1e4 / RATE_Hz + 0.01
    assert output_V.max() == 10.0
    np.testing.assert_allclose(output_V / 0.01, np.round(output_V / 0.01), atol=1e-9)
    assert output_V[4000] < 10.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_all_plants_keep_their_margins_and_no_larger_gain_does(sign):
    result = tune(family(sign))
    assert len(result.margins) == 5
    assert min(m.modulus_margin for m in result.margins) >= 0.5
    larger = result.pid.scaled(1.1).polynomials()
    larger_margins = [margins(member, *larger) for member in family(sign).members]
    assert min(m.modulus_margin for m in larger_margins) < 0.5
    assert np.sign(result.pid.integral_V_per_m_s) == sign


def test_a_notch_permits_ten_times_the_gain_and_a_delay_margin_costs_gain():
    without, with_notch = (tune(notches=n).pid.integral_V_per_m_s for n in (0, 1))
    assert with_notch > 10 * without
    assert tune(notches=1).pid.notches[0].frequency_Hz == pytest.approx(630.0, rel=1e-3)
    result = tune(delay_margin_s=5e-4)
    assert min(m.delay_margin_s for m in result.margins if m.delay_margin_s) >= 5e-4
    assert result.pid.integral_V_per_m_s < tune().pid.integral_V_per_m_s


def test_an_impossible_pid_is_refused_with_another_target():
    plants = PlantFamily(
        members=(plant_from_chain(chain()), replace(plant_from_chain(chain(-1.0)), label="other"))
    )
    with pytest.raises(DesignError, match=r"no PID with 1 notches.*--target waveform"):
        tune(plants)


def test_the_simulated_loop_rejects_a_disturbance_as_computed():
    """The disturbance has 40 Hz, and the plant has no hysteresis."""
    pid = tune().pid
    plant = lateral(
        response=CustomResponse(begin=lambda _: lambda v: GAIN_m_per_V * v),
        noise_rms=0.0,
        delay_s=0.0,
    )
    time_s = np.arange(20000) / RATE_Hz
    wave_m = 1e-7 * np.sin(2 * np.pi * 40.0 * time_s)
    run = run_law(
        plant,
        pid_law(pid),
        np.zeros(20000),
        rng=np.random.default_rng(0),
        disturbance=wave_m,
    )
    tone = np.exp(-2j * np.pi * 40.0 * time_s[10000:])
    rejection = abs(np.mean(run.position[10000:] * tone) / np.mean(wave_m[10000:] * tone))
    expected = sensitivities(family().nominal, *pid.polynomials(), np.array([40.0])).Syp[0]
    assert rejection == pytest.approx(abs(expected), rel=0.03)


@cache
def files():
    return pid_files(exported())


@cache
def pid_result():
    return pid_of(exported(), exported().lateral[0])


def test_files_contain_settings_sections_and_the_performance_loss():
    contents, notes = files()
    pid, _, errors_m = pid_result()
    rows = csv_rows(contents["settings.csv"])
    settings = {row["setting"]: (float(row["value"]), row["unit"]) for row in rows}
    assert settings["integral"] == (pid.integral_V_per_m_s, "V/(m s)")
    rows = errors_m.values()
    exported_m, pid_m = (max(row[name] for row in rows) for name in ("exported", "pid"))
    assert (
        f"errs by {with_unit(pid_m, 'm')} rms instead of {with_unit(exported_m, 'm')}" in notes[0]
    )
    readme = contents["README.md"].decode()
    assert "| draw 2 |" in readme


@pytest.mark.parametrize("update_Hz", [None, 122189.638])
def test_sections_have_the_response_of_the_controller(update_Hz):
    hardware = ControllerHardware(update_Hz=update_Hz)
    contents, _ = pid_files(replace(exported(), hardware=hardware)) if update_Hz else files()
    pid, _, _ = pid_result()
    frequency_Hz = np.geomspace(1.0, 2e3, 40)
    q = np.exp(-2j * np.pi * frequency_Hz / (update_Hz or RATE_Hz))
    response = np.ones(40, dtype=complex)
    for row in csv_rows(contents["sections.csv"]):
        b0, b1, b2, a1, a2 = (float(row[name]) for name in ("b0", "b1", "b2", "a1", "a2"))
        response *= (b0 + b1 * q + b2 * q**2) / (1.0 + a1 * q + a2 * q**2)
    R, S = pid.polynomials()
    q_controller = np.exp(-2j * np.pi * frequency_Hz / RATE_Hz)
    reference = np.polyval(R[::-1], q_controller) / np.polyval(S[::-1], q_controller)
    tolerance = 1e-9 if update_Hz is None else 0.3  # holds differ towards the Nyquist frequency
    assert np.abs(response / reference - 1.0).max() < tolerance


def test_a_slew_limit_is_simulated():
    axis = exported().lateral[0]
    limited = replace(exported(), hardware=ControllerHardware(slew_V_per_s=50.0))
    (pid, _, limited_m), (_, _, unlimited_m) = pid_of(limited, axis), pid_result()
    assert pid.slew_V_per_s == 50.0
    label = next(iter(unlimited_m))
    assert limited_m[label]["pid"] > 2 * unlimited_m[label]["pid"]
