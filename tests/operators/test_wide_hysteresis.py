"""The wide class of hysteresis: rate independent, and the same however a drive is cut."""

import numpy as np
import pytest

from piezoid.operators.wide_hysteresis import (
    EDGES,
    WIDTHS,
    HysteresisStates,
    class_columns,
    coefficients,
    smooth_columns,
    smooth_response,
)

DRIVE = np.sin(np.linspace(0.0, 20.0, 400)) * np.linspace(1.0, 0.2, 400)


def test_a_drive_in_chunks_leaves_the_same_states() -> None:
    whole = HysteresisStates((-1.0, 0.5)).follow(DRIVE)
    states = HysteresisStates((-1.0, 0.5))
    parts = [states.follow(part) for part in np.array_split(DRIVE, 7)]
    for k, table in enumerate(whole):
        assert np.array_equal(np.concatenate([part[k] for part in parts]), table)


def test_columns_do_not_depend_on_speed() -> None:
    slow = np.interp(np.arange(0, 399.01, 0.25), np.arange(400), DRIVE)
    quick, often = (class_columns(u, HysteresisStates(()).follow(u)) for u in (DRIVE, slow))
    assert often[::4] == pytest.approx(quick, abs=2e-4)


def test_coefficients_of_all_columns_become_a_density_and_the_others() -> None:
    states = HysteresisStates(()).follow(DRIVE)
    columns = class_columns(DRIVE, states)
    weights = np.random.default_rng(0).standard_normal(columns.shape[1])
    density, smooth = coefficients(weights)
    assert density.shape == (len(WIDTHS), len(EDGES) - 1)
    rest = smooth_columns(DRIVE, states) @ smooth
    cells = np.clip(states[0][:, :, None], EDGES[:-1], EDGES[1:])
    cells = cells - np.clip(DRIVE[:, None, None], EDGES[:-1], EDGES[1:])
    made = np.einsum("kwc,wc->k", cells, density) + rest
    assert made == pytest.approx(columns @ weights, rel=1e-9, abs=1e-9)


def test_the_response_is_the_sum_of_the_columns() -> None:
    states = HysteresisStates((-1.0, 0.5)).follow(DRIVE)
    columns = smooth_columns(DRIVE, states)
    weights = np.random.default_rng(1).standard_normal(columns.shape[1])
    assert smooth_response(DRIVE, states, weights) == pytest.approx(columns @ weights, abs=1e-12)
