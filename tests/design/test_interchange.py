"""A designed loop in scipy and python-control is the loop whose margins were computed."""

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


def test_the_sensitivity_is_that_of_the_margins(loop) -> None:
    system = loop.to_scipy("sensitivity")
    w = 2 * np.pi * FREQUENCY_Hz / RATE_Hz
    _, found = system.freqresp(w)
    expected = sensitivities(loop.members[0], loop.R, loop.S, FREQUENCY_Hz).Syp
    assert np.allclose(found, expected, rtol=1e-6)
    assert system.dt == pytest.approx(1.0 / RATE_Hz)


def test_parts_fit_together(loop) -> None:
    """Closed loop = prefilter R B / P, and sensitivity + R B / P = 1."""
    w = 2 * np.pi * FREQUENCY_Hz / RATE_Hz
    at = {
        part: loop.to_scipy(part).freqresp(w)[1]
        for part in ("controller", "prefilter", "plant", "sensitivity", "closed_loop")
    }
    open_loop = at["controller"] * at["plant"]
    assert np.allclose(at["sensitivity"] * (1.0 + open_loop), 1.0, rtol=1e-6)
    inner = open_loop * at["sensitivity"]
    assert np.allclose(at["closed_loop"], at["prefilter"] * inner, rtol=1e-6)


def test_control_has_the_same_loop(loop) -> None:
    control = pytest.importorskip("control")
    found = loop.to_control("closed_loop")
    w = 2 * np.pi * FREQUENCY_Hz
    _, expected = loop.to_scipy("closed_loop").freqresp(w / RATE_Hz)
    assert np.allclose(np.squeeze(control.frequency_response(found, w).complex), expected)


def test_a_part_that_is_none_is_refused(loop) -> None:
    with pytest.raises(DesignError, match=r"'motor' is not a part of a loop\. Needed: one of"):
        loop.to_scipy("motor")
