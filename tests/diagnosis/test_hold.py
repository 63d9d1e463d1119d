"""What a converter's staircase comes to behind the poles of amplifier and sensor."""

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from piezoid.diagnosis.segments import staircase_response
from piezoid_datasets.virtual_lab.campaign import draw_campaign

from .bench import recorded, view_of_recordings

RATE_Hz = 20e3


def behind(command, poles_Hz):
    """The same by state space: zero-order hold of the product of the poles."""
    denominator = np.array([1.0])
    for pole_Hz in poles_Hz:
        denominator = np.polymul(denominator, [1.0 / (2.0 * np.pi * pole_Hz), 1.0])
    numerator, denominator, _ = cont2discrete(([1.0], denominator), 1.0 / RATE_Hz, method="zoh")
    out = lfilter(numerator[0], denominator, command - command[0])
    return out + command[0]


@pytest.mark.parametrize("poles_Hz", [(4e3,), (4e3, 8.5e3), (8.5e3, 4e3), (300.0, 9e3)])
def test_a_held_command_comes_out_as_a_state_space_of_the_same_poles_has_it(poles_Hz):
    command = np.random.default_rng(3).uniform(-1.0, 1.0, 400)
    assert np.allclose(
        staircase_response(command, poles_Hz, RATE_Hz), behind(command, poles_Hz), atol=1e-12
    )


def test_two_equal_poles_answer_a_step_by_the_closed_form():
    command = np.concatenate([[0.0], np.ones(40)])
    time = 2.0 * np.pi * 2e3 * np.arange(-1, 40) / RATE_Hz
    expected = np.where(time > 0, 1.0 - (1.0 + time) * np.exp(-time), 0.0)
    assert np.allclose(staircase_response(command, (2e3, 2e3), RATE_Hz), expected, atol=1e-4)


def test_a_pole_that_is_not_declared_leaves_the_hold_of_one_sample():
    command = np.array([0.3, 1.0, -2.0, 4.0])
    assert staircase_response(command, (None, None), RATE_Hz).tolist() == [0.3, 0.3, 1.0, -2.0]


def test_a_fast_chirp_of_a_healthy_stage_leaves_the_noise():
    campaign = draw_campaign(70055, plans=("sweep", "chirp"))
    view = view_of_recordings(*recorded(campaign))
    chirp = view.null.residual[slice(*view.nuisance.edges[1:3])]
    assert np.std(chirp) < 1.25 * view.noise
