"""The Bouc-Wen benchmark identifies a simulated mode; absent records are skipped."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from benchmarks.records.__main__ import RECORDS, main
from benchmarks.records.bouc_wen.fit import fit
from benchmarks.records.bouc_wen.mode import BoucWenMode, band_limited


def test_a_record_that_is_absent_is_named_and_passed_over(tmp_path, capsys):
    assert main(["--data", str(tmp_path)]) == 0
    assert capsys.readouterr().out.splitlines() == [
        f"{record.NAME}: skipped, {tmp_path / record.FOLDER} is absent. "
        "Name its parent with --data."
        for record in RECORDS
    ]


def test_a_record_of_another_name_is_refused(capsys):
    with pytest.raises(SystemExit):
        main(["bouc-wen"])
    assert "no record bouc-wen; there are bouc_wen" in capsys.readouterr().err


def test_a_bouc_wen_mode_is_identified_from_a_multisine():
    """`python -m benchmarks.records` fits the published record."""
    rng, samples, rate_Hz, noise_m = np.random.default_rng(0), 1500, 750.0, 1e-8
    mode = BoucWenMode(
        mass=2.0, damping=10.0, stiffness=5e4, quadratic=0.0, cubic=0.0, spring_stiffness=5e4,
        beta=1.0, gamma=-0.8, exponent=1.0, bias=0.0, size_m=5e-4,
    )  # fmt: skip
    spectrum = np.zeros(samples // 2 + 1, dtype=complex)
    spectrum[11:300] = np.exp(2j * np.pi * rng.random(289))  # 5 to 150 Hz
    force = np.fft.irfft(spectrum, samples)
    force *= 50.0 / force.std()
    displacement_m = mode.simulate(force, rate_Hz)
    identified = fit(force, displacement_m + noise_m * rng.standard_normal(samples), rate_Hz)
    assert identified.residual_rms_m < 1.05 * noise_m
    assert displacement_m.std() > 1e4 * noise_m
    for name, truth in (("mass", 2.0), ("damping", 10.0), ("spring_stiffness", 5e4)):
        low, high = identified.interval[name]
        assert low - 1e-3 * truth < truth < high + 1e-3 * truth


@pytest.mark.parametrize(("gamma", "exponent"), [(-2.2, 1.0), (0.3, 1.8)])
def test_the_simulation_solves_the_differential_equation(gamma, exponent):
    rate_Hz, samples, size_m = 800.0, 400, 1e-3
    time_s = np.arange(samples) / rate_Hz
    force = 40.0 * np.sin(2 * np.pi * 31.0 * time_s) + 25.0 * np.sin(2 * np.pi * 9.0 * time_s)
    mode = BoucWenMode(
        mass=2.0, damping=12.0, stiffness=6e4, quadratic=2e6, cubic=1e9, spring_stiffness=4e4,
        beta=1.6, gamma=gamma, exponent=exponent, bias=0.0, size_m=size_m,
    )  # fmt: skip
    fine = band_limited(force, 8)
    applied = CubicSpline(np.arange(len(fine)) / (8 * rate_Hz), fine)

    def rate(t: float, x: np.ndarray) -> list[float]:
        y, v, z = x
        spring = y * (6e4 + y * (2e6 + y * 1e9)) + 4e4 * z
        grip = gamma + 1.6 * np.sign(z * v)
        hardening = 1.0 - abs(z / size_m) ** exponent * grip
        return [v, (applied(t) - 12.0 * v - spring) / 2.0, v * hardening]

    solved = solve_ivp(
        rate, (0.0, time_s[-1]), [0, 0, 0], t_eval=time_s, rtol=1e-9, atol=1e-13, max_step=1e-3
    ).y[0]
    simulated = mode.simulate(force, rate_Hz)
    assert np.abs(simulated - solved).max() < 3e-4 * np.abs(solved).max()
