"""Cycles of one range whose sensitivity falls: the fit and the diagnosis say the same of them."""

import re
from typing import Literal

import numpy as np
import pytest

from piezoid.diagnosis.diagnose import diagnose
from piezoid.numerics.arrays import Array
from piezoid.records.frames import from_arrays
from tests.laws import LAWS, triangles

CYCLES, SAMPLES, RATE_Hz = 60, 120, 120.0  # one cycle in a second
LOSS = 0.013  # of the sensitivity, over all cycles
NOISE_M = 5e-9
LAG_S = 0.02


def lagged(moved_m: Array) -> Array:
    share, slow_m = 1.0 - np.exp(-1.0 / (RATE_Hz * LAG_S)), moved_m.copy()
    for k in range(1, len(moved_m)):
        slow_m[k] = slow_m[k - 1] + share * (moved_m[k] - slow_m[k - 1])
    return slow_m


@pytest.mark.slow
@pytest.mark.usefixtures("one_order")
@pytest.mark.parametrize("beside", ["dropouts", "lag"])
def test_a_loss_of_sensitivity_is_named_beside_dropouts_or_a_lag(
    beside: Literal["dropouts", "lag"],
) -> None:
    rng, field = np.random.default_rng(3), triangles(CYCLES + 3, SAMPLES)
    moved_m = 2e-5 * LAWS["bouc_wen"](field)[3 * SAMPLES :]
    moved_m = moved_m * (1.0 - LOSS * np.linspace(0.0, 1.0, len(moved_m)))
    if beside == "lag":
        moved_m = lagged(moved_m)
    moved_m = moved_m + NOISE_M * rng.standard_normal(len(moved_m))
    if beside == "dropouts":
        moved_m[rng.integers(0, len(moved_m), 12)] = 0.0
    diagnosis = diagnose(
        [
            from_arrays(
                voltage_V=50.0 + 50.0 * field[3 * SAMPLES :],
                displacement_m=moved_m,
                sampling_rate_Hz=RATE_Hz,
                axis="x",
                name="cycles",
            )
        ]
    )
    findings = {finding.effect: finding for finding in diagnosis.findings}
    allowed = {"gain_change", "loop_shape"} | ({"outliers"} if beside == "dropouts" else set())
    assert "gain_change" in findings
    assert set(findings) <= allowed
    size = findings["gain_change"].size
    assert size is not None
    assert size.value == pytest.approx(-100.0 * LOSS, rel=0.1)
    assert diagnosis.model is not None
    remarks = " ".join(diagnosis.model.verdict.remarks)
    stated = re.search(r"the sensitivity changes by (\S+) %", remarks)
    assert stated is not None
    assert float(stated.group(1)) == pytest.approx(size.value, rel=0.1)
    assert diagnosis.final.rms_m < 1.5 * NOISE_M
