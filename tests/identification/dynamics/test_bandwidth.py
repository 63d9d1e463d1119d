"""A stated bandwidth of 630 Hz: pole or resonance, said with phase and peak."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.errors import ExcitationError
from piezoid.identification.dynamics.bandwidth import decide_bandwidth
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.periodic_estimate import estimate_response
from piezoid.operators.analogue import first_order, resonance
from piezoid.operators.linear import ContinuousSystem
from tests.identification.dynamics.stage import record


def seen(rng: np.random.Generator, system: ContinuousSystem, sign: int = 1) -> FrequencyResponse:
    measured = estimate_response(record(rng, noise_m=2e-9))
    response = 1e-6 * sign * system.response(measured.frequency_Hz)
    return replace(measured, response=response)


@pytest.mark.parametrize("sign", [1, -1])
def test_a_pole_is_called_first_order(rng: np.random.Generator, sign: int) -> None:
    verdict = decide_bandwidth(seen(rng, first_order(630), sign), 630)
    assert verdict.kind == "first_order"
    assert verdict.phase_deg == pytest.approx(-45, abs=0.5)
    assert "first-order pole" in verdict.text


@pytest.mark.parametrize("damping", [0.02, 0.1, 0.7])
def test_a_mode_is_called_a_resonance_with_or_without_a_peak(
    rng: np.random.Generator, damping: float
) -> None:
    verdict = decide_bandwidth(seen(rng, resonance(630, damping)), 630)
    assert verdict.kind == "resonance"
    assert verdict.phase_deg == pytest.approx(-90, abs=1.0)


def test_an_undeclared_delay_is_not_guessed_away(rng: np.random.Generator) -> None:
    """A pole with 140 us looks like a mode by its phase; declared, it is a pole again."""
    pole = first_order(630)
    late = ContinuousSystem(A=pole.A, B=pole.B, C=pole.C, D=pole.D, delay_s=140e-6)
    assert decide_bandwidth(seen(rng, late), 630).kind != "first_order"
    assert decide_bandwidth(seen(rng, late), 630, delay_s=140e-6).kind == "first_order"


def test_a_resonance_elsewhere_leaves_the_bandwidth_undecided(rng: np.random.Generator) -> None:
    verdict = decide_bandwidth(seen(rng, resonance(1100, 0.02)), 630)
    assert verdict.kind == "undecided"
    assert verdict.peak_frequency_Hz == pytest.approx(1100, abs=20)


def test_a_bandwidth_outside_the_lines_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(ExcitationError, match="Excite that band"):
        decide_bandwidth(seen(rng, first_order(630)), 6300)
