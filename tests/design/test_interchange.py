"""A designed loop in scipy and python-control is the loop of the computed margins."""

import numpy as np
import pytest

import piezoid
from piezoid.design.sensitivity import sensitivities
from piezoid.errors import DesignError
from tests.design.designed import known_design
from tests.verification.rig import RATE_Hz

FREQUENCY_Hz = np.array([1.0, 30.0, 400.0, 3000.0])


@pytest.fixture(scope="module")
def loop() -> piezoid.LoopDesign:
    return known_design().axes[0].recommended


def test_the_scipy_sensitivity_equals_that_of_the_margins(loop):
    system = loop.to_scipy("sensitivity")
    w = 2 * np.pi * FREQUENCY_Hz / RATE_Hz
    _, response = system.freqresp(w)
    expected = sensitivities(loop.members[0], loop.R, loop.S, FREQUENCY_Hz).Syp
    assert np.allclose(response, expected, rtol=1e-6)
    assert system.dt == pytest.approx(1.0 / RATE_Hz)


def test_closed_loop_and_sensitivity_follow_from_the_other_parts(loop):
    """The closed loop is prefilter R B / P, and sensitivity + R B / P = 1."""
    w = 2 * np.pi * FREQUENCY_Hz / RATE_Hz
    responses = {
        part: loop.to_scipy(part).freqresp(w)[1]
        for part in ("controller", "prefilter", "plant", "sensitivity", "closed_loop")
    }
    open_loop = responses["controller"] * responses["plant"]
    assert np.allclose(responses["sensitivity"] * (1.0 + open_loop), 1.0, rtol=1e-6)
    inner = open_loop * responses["sensitivity"]
    assert np.allclose(responses["closed_loop"], responses["prefilter"] * inner, rtol=1e-6)


def test_control_has_the_same_loop(loop):
    control = pytest.importorskip("control")
    system = loop.to_control("closed_loop")
    w = 2 * np.pi * FREQUENCY_Hz
    _, expected = loop.to_scipy("closed_loop").freqresp(w / RATE_Hz)
    assert np.allclose(np.squeeze(control.frequency_response(system, w).complex), expected)


def test_an_unknown_part_is_refused(loop):
    with pytest.raises(DesignError, match=r"'motor' is not a part of a loop\. Needed: one of"):
        loop.to_scipy("motor")
