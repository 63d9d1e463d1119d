"""Sweeps with drift, clipping, offset or unknown bias."""

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
from piezoid.records.table import RawTable

DECAY_per_m = 20e9
TRAVEL_m = 0.6e-9
ROWS = 150
SPEED_m_per_s = 0.5e-9


def sweeps(
    rng: np.random.Generator,
    *,
    decay_per_m: float = DECAY_per_m,
    drift_m_per_s: float = 0.0,
    offset_A: float = 0.0,
    top_A: float = 5e-10,
    range_A: float = np.inf,
    converter_noise_A: float = 0.0,
) -> tuple[Array, Array, Array]:
    """Return height and currents of a retraction and an approach while the gap opens steadily.

    converter_noise_A  noise added after clipping
    """
    height_m = np.linspace(0.0, TRAVEL_m, ROWS)
    currents_A = []
    for time_s in (height_m / SPEED_m_per_s, (2 * TRAVEL_m - height_m) / SPEED_m_per_s):
        law_A = top_A * np.exp(-decay_per_m * (height_m + drift_m_per_s * time_s))
        jitter = 1.0 + 0.01 * rng.standard_normal(ROWS)
        dark_A = offset_A + 2e-14 * rng.standard_normal(ROWS)
        clipped_A = np.clip(law_A * jitter + dark_A, -range_A, range_A)
        currents_A.append(clipped_A + converter_noise_A * rng.standard_normal(ROWS))
    return height_m, currents_A[0], currents_A[1]


def written(
    path: Path, height_m: Array, *currents_A: Array, bias: str = "20E-3", head: str = ""
) -> RawTable:
    """Return the table of a file with these columns: forward, then backward if there are two."""
    names = ["Z rel (m)", "Current (A)", "Current [bwd] (A)"][: 1 + len(currents_A)]
    rows = zip(height_m, *currents_A, strict=True)
    lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
    path.write_text(
        f"Experiment\tZ spectroscopy\t\nBias>Bias (V)\t{bias}\t\n{head}\n[DATA]\n"
        + "\n".join(["\t".join(names), *lines])
        + "\n"
    )
    return read_table(path)


def fitted(path: Path, height_m: Array, *currents_A: Array, **header: str) -> TunnellingModel:
    """Fit a file with these columns: forward, then backward if there are two."""
    model = fit_junction([written(path, height_m, *currents_A, **header)])
    assert model is not None
    return model


def law_of(model: TunnellingModel) -> GapLaw:
    assert model.gap_law is not None
    return model.gap_law


@pytest.mark.parametrize("drift_m_per_s", [100e-12, -100e-12, 0.0])
def test_both_directions_together_cancel_a_drift_of_a_fifth_of_the_speed(
    tmp_path, rng, drift_m_per_s
):
    model = fitted(tmp_path / "z.dat", *sweeps(rng, drift_m_per_s=drift_m_per_s))
    law = law_of(model)
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
    assert law.decay_per_m == pytest.approx(DECAY_per_m, rel=0.01)
    assert np.ptp(law.decay_interval_per_m) < 0.1 * DECAY_per_m
    share = drift_m_per_s / SPEED_m_per_s
    assert model.forward.decay_per_m == pytest.approx(DECAY_per_m * (1.0 + share), rel=0.02)
    is_stated = any("drifted or crept" in reason for reason in law.reasons)
    assert is_stated == (drift_m_per_s != 0.0)


@pytest.mark.parametrize("spread", [0.0, 0.05])
def test_several_pairs_determine_their_mean_decay_as_well_as_they_agree(tmp_path, rng, spread):
    decays = DECAY_per_m * (1.0 + spread * np.array([-1.2, -0.4, 0.4, 1.2]))
    pairs = [sweeps(rng, decay_per_m=decay) for decay in decays]
    model = fit_junction(
        [written(tmp_path / f"{number}.dat", *pair) for number, pair in enumerate(pairs)]
    )
    assert model is not None
    law = law_of(model)
    assert law.sweep_decay_per_m == pytest.approx(decays, rel=0.01)
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
    # Student's t of three degrees of freedom times the scatter of four.
    half = 3.18 * spread * np.sqrt(1.07) / 2.0
    assert np.ptp(law.decay_interval_per_m) / (2.0 * DECAY_per_m) == pytest.approx(half, abs=0.01)


def test_one_direction_alone_covers_the_drift_by_its_interval_and_states_it(tmp_path, rng):
    for drift_m_per_s in (100e-12, -100e-12):
        height_m, away_A, _ = sweeps(rng, drift_m_per_s=drift_m_per_s)
        law = law_of(fitted(tmp_path / "z.dat", height_m, away_A))
        assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
        assert law.confidence.value != "high"
        assert any("one way only" in reason for reason in law.reasons)


@pytest.mark.parametrize("module", ["", "Z Spectroscopy>"])
def test_a_header_with_the_time_of_a_row_limits_the_drift(tmp_path, rng, module):
    height_m, away_A, _ = sweeps(rng)
    fast = f"{module}Settling time (s)\t100E-6\t\n{module}Integration time (s)\t100E-6\t\n"
    stated = law_of(fitted(tmp_path / "z.dat", height_m, away_A, head=fast))
    unstated = law_of(fitted(tmp_path / "z.dat", height_m, away_A))
    assert np.ptp(stated.decay_interval_per_m) < 0.1 * np.ptp(unstated.decay_interval_per_m)


@pytest.mark.parametrize("converter_noise_A", [0.0, 5e-12])
def test_rows_at_the_limit_of_the_preamplifier_are_excluded_and_counted(
    tmp_path, rng, converter_noise_A
):
    """More than a third of a decade is clipped, exactly or with noise of the converter."""
    columns = sweeps(rng, top_A=5e-9, range_A=1.2e-9, converter_noise_A=converter_noise_A)
    law = law_of(fitted(tmp_path / "z.dat", *columns))
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]
    assert law.decay_per_m == pytest.approx(DECAY_per_m, rel=0.02)
    cut = np.count_nonzero(columns[0] < np.log(5.0 / 1.2) / DECAY_per_m)
    counts = [re.search(r"(\d+) of 150 rows lie at", reason) for reason in law.reasons]
    stated_counts = [int(count[1]) for count in counts if count is not None]
    assert stated_counts
    assert all(cut <= count <= cut + 6 for count in stated_counts)


def test_a_sweep_within_the_range_has_no_clipped_rows(rng):
    for _ in range(20):
        height_m, *currents_A = sweeps(rng, converter_noise_A=1e-12)
        for current_A, direction in zip(currents_A, Direction, strict=True):
            curve = read_approach(
                height_m, current_A, bias_V=None, direction=direction, label="whole"
            )
            assert curve.saturated == 0


def test_an_offset_of_picoamperes_is_removed(tmp_path, rng):
    law = law_of(fitted(tmp_path / "z.dat", *sweeps(rng, offset_A=4e-12)))
    assert law.offset_A == pytest.approx(4e-12, abs=5.0 * law.offset_standard_A)
    assert law.decay_interval_per_m[0] < DECAY_per_m < law.decay_interval_per_m[1]


def test_a_header_without_bias_leaves_the_sign_to_the_current(tmp_path, rng):
    height_m, away_A, back_A = sweeps(rng)
    unknown = fitted(tmp_path / "z.dat", height_m, -away_A, -back_A, bias="0E+0")
    expected = fitted(tmp_path / "z.dat", height_m, -away_A, -back_A, bias="-1E-3")
    assert law_of(unknown) == replace(law_of(expected), polarity=-1.0)
