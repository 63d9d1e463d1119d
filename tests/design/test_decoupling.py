"""Decoupling matrix of coupled axes: exact at rest, with the remaining coupling stated."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.decoupling import decoupling_of
from piezoid.errors import DesignError
from tests.coupled_axes import STATIC_M_PER_V, coupled_axes


def test_the_matrix_makes_the_static_gain_diagonal():
    decoupling = decoupling_of(coupled_axes(), 50.0)
    gain_m_per_V = decoupling.matrix @ STATIC_M_PER_V
    np.testing.assert_allclose(gain_m_per_V, np.diag(np.diag(STATIC_M_PER_V)), atol=5e-3 * 3.5e-6)


def test_the_remaining_coupling_grows_towards_the_modes():
    slow, fast = (decoupling_of(coupled_axes(), f_Hz) for f_Hz in (20.0, 200.0))
    np.testing.assert_allclose(slow.before[0, 1], 0.12, rtol=0.02)
    assert slow.left.max() < 0.01 * slow.before.max()
    assert fast.left.max() > 20.0 * slow.left.max()
    assert "Up to 200 Hz axes move each other" in fast.text


def test_a_drive_that_does_not_move_its_axis_is_refused():
    axes = coupled_axes()
    residue = axes.residue_m_per_V.copy()
    residue[:, :, 0, 0] *= 1e-4
    with pytest.raises(DesignError, match="motion by its drive is in its own displacement"):
        decoupling_of(replace(axes, residue_m_per_V=residue), 50.0)
