"""The error on what was left out is one of simulation, where zeros move as well."""

from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.streamed.fit_streamed import fit_streamed
from piezoid.records.streams.spool import spooled

RATE_Hz = 1000.0
NOISE_m = 5e-9


def test_a_knot_that_the_first_half_just_touches_goes_nowhere(tmp_path: Path) -> None:
    t = np.arange(12_000) / RATE_Hz
    u = 5 * (0.3 + 0.7 * np.abs(np.cos(np.pi * t / 3))) * np.sin(2 * np.pi * 5 * t)
    memory, moved = 0.0, np.empty(len(t))
    for k, v in enumerate(u):
        memory = max(v - 1.0, min(v + 1.0, memory))
        moved[k] = 2e-6 * v + 5e-7 * memory
    moved += NOISE_m * np.random.default_rng(2).standard_normal(len(t)) + 1e-7 * t / t[-1]
    place = tmp_path / "run.csv"
    heading = "time [s],voltage [V],position [um]"
    rows = np.column_stack([t, u, 1e6 * moved])
    np.savetxt(place, rows, "%.9g", ",", header=heading, comments="")
    with spooled([place]) as spool:
        quality = fit_streamed(spool, orders=((2, 1),))["x"].quality
    assert quality.held_out_rms_m == pytest.approx(quality.rms_m, rel=1.0)
    assert quality.rms_m == pytest.approx(NOISE_m, rel=0.1)
