"""Drift, clipping, offset, a bias that the file does not know: sweeps as laboratories record."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from piezoid.identification.tunnelling.approach import Direction, read_approach
from piezoid.identification.tunnelling.barrier_fit import GapLaw
from piezoid.identification.tunnelling.junction import TunnellingModel, fit_junction
from piezoid.numerics.arrays import Array
from piezoid.records.readers import read_table

DECAY_per_m = 20e9
TRAVEL_m = 0.6e-9
ROWS = 150
SPEED_m_per_s = 0.5e-9


def sweeps(
    rng: np.random.Generator,
    *,
    drift_m_per_s: float = 0.0,
    offset_A: float = 0.0,
    top_A: float = 5e-10,
    range_A: float = np.inf,
    behind_A: float = 0.0,
) -> tuple[Array, Array, Array]:
    """Height, current away from the surface and back, of a gap that opens steadily.

    behind_A  noise from behind the stage that clips
    """
    height_m = np.linspace(0.0, TRAVEL_m, ROWS)
    ways = []
    for time_s in (height_m / SPEED_m_per_s, (2 * TRAVEL_m - height_m) / SPEED_m_per_s):
        law_A = top_A * np.exp(-DECAY_per_m * (height_m + drift_m_per_s * time_s))
        jitter = 1.0 + 0.01 * rng.standard_normal(ROWS)
        dark_A = offset_A + 2e-14 * rng.standard_normal(ROWS)
        clipped_A = np.clip(law_A * jitter + dark_A, -range_A, range_A)
        ways.append(clipped_A + behind_A * rng.standard_normal(ROWS))
    return height_m, ways[0], ways[1]


def fitted(
    place: Path, height_m: Array, *ways: Array, bias: str = "20E-3", head: str = ""
) -> TunnellingModel:
    """What is found in a file of these columns: forward, then backward where there are two."""
    names = ["Z rel (m)", "Current (A)", "Current [bwd] (A)"][: 1 + len(ways)]
    rows = zip(height_m, *ways, strict=True)
    lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
    place.write_text(
        f"Experiment\tZ spectroscopy\t\nBias>Bias (V)\t{bias}\t\n{head}\n[DATA]\n"
        + "\n".join(["\t".join(names), *lines])
        + "\n"
    )
    model = fit_junction([read_table(place)])
    assert model is not None
    return model


def law_of(model: TunnellingModel) -> GapLaw:
    assert model.gap_law is not None
    return model.gap_law


@pytest.mark.parametrize("drift_m_per_s", [100e-12, -100e-12, 0.0])
def test_to_and_fro_together_are_free_of_a_drift_of_a_fifth_of_the_speed(
    tmp_path, rng, drift_m_per_s
):
    model = fitted(tmp_path / "z.dat", *sweeps(rng, drift_m_per_s=drift_m_per_s))
    law = law_of(model)
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
    assert law.decay_per_m == pytest.approx(DECAY_per_m, rel=0.01)
    assert np.ptp(law.decay_interval_per_m) < 0.1 * DECAY_per_m
    assert model.forward is not None
    share = drift_m_per_s / SPEED_m_per_s
    assert model.forward.decay_per_m == pytest.approx(DECAY_per_m * (1.0 + share), rel=0.02)
    told = any("drifted or crept" in reason for reason in law.reasons)
    assert told == (drift_m_per_s != 0.0)


def test_one_way_alone_holds_the_drift_in_its_interval_and_says_so(tmp_path, rng):
    for drift_m_per_s in (100e-12, -100e-12):
        height_m, away_A, _ = sweeps(rng, drift_m_per_s=drift_m_per_s)
        law = law_of(fitted(tmp_path / "z.dat", height_m, away_A))
        assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
        assert law.confidence.value != "high"
        assert any("one way only" in reason for reason in law.reasons)


@pytest.mark.parametrize("module", ["", "Z Spectroscopy>"])
def test_a_head_that_states_the_time_of_a_row_narrows_what_drift_may_be(tmp_path, rng, module):
    height_m, away_A, _ = sweeps(rng)
    fast = f"{module}Settling time (s)\t100E-6\t\n{module}Integration time (s)\t100E-6\t\n"
    stated = law_of(fitted(tmp_path / "z.dat", height_m, away_A, head=fast))
    unstated = law_of(fitted(tmp_path / "z.dat", height_m, away_A))
    assert np.ptp(stated.decay_interval_per_m) < 0.1 * np.ptp(unstated.decay_interval_per_m)


@pytest.mark.parametrize("behind_A", [0.0, 5e-12])
def test_rows_at_the_preamplifiers_limit_are_left_out_and_counted(tmp_path, rng, behind_A):
    """A third of a decade and more is cut off, exactly or under noise of the converter."""
    held = sweeps(rng, top_A=5e-9, range_A=1.2e-9, behind_A=behind_A)
    law = law_of(fitted(tmp_path / "z.dat", *held))
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
    assert law.decay_per_m == pytest.approx(DECAY_per_m, rel=0.02)
    cut = np.count_nonzero(held[0] < np.log(5.0 / 1.2) / DECAY_per_m)
    counts = [re.search(r"(\d+) of 150 rows lie at", reason) for reason in law.reasons]
    told = [int(count[1]) for count in counts if count is not None]
    assert told
    assert all(cut <= count <= cut + 6 for count in told)


def test_no_row_of_a_sweep_within_the_range_is_taken_for_clipped(rng):
    for _ in range(20):
        height_m, *ways = sweeps(rng, behind_A=1e-12)
        for current_A, direction in zip(ways, Direction, strict=True):
            curve = read_approach(
                height_m, current_A, bias_V=None, direction=direction, label="whole"
            )
            assert curve.saturated == 0


def test_an_offset_of_picoamperes_moves_nothing(tmp_path, rng):
    law = law_of(fitted(tmp_path / "z.dat", *sweeps(rng, offset_A=4e-12)))
    assert law.offset_A == pytest.approx(4e-12, abs=5.0 * law.offset_standard_A)
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]


def test_a_head_of_zero_bias_leaves_the_sign_to_the_current(tmp_path, rng):
    height_m, away_A, back_A = sweeps(rng)
    unknown = fitted(tmp_path / "z.dat", height_m, -away_A, -back_A, bias="0E+0")
    known = fitted(tmp_path / "z.dat", height_m, -away_A, -back_A, bias="-1E-3")
    assert law_of(unknown) == replace(law_of(known), polarity=-1.0)
