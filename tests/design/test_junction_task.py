"""Design task of an identified junction: its family, its limits, missing declarations."""

import math
from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.design_stage import design_stage
from piezoid.design.junction_task import reading_noise_A, vertical_task
from piezoid.design.specification import converters_of
from piezoid.errors import DesignError, LabFileError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.tunnelling.barrier_fit import fit_barrier
from piezoid.identification.tunnelling.junction import TunnellingModel
from piezoid.records.lab import Acquisition, Amplifier, Tunnelling
from tests.design.junction_lab import LAB, loop_plant
from tests.design.rig import RATE_Hz
from tests.identification.tunnelling.sweeps import sweep

LOOP = TunnellingModel(gap_law=None, loop_plant=loop_plant())


def test_the_sampled_family_equals_the_identified_family():
    """Design and identification sample the same analogue chain independently."""
    family = vertical_task(LOOP, replace(LAB, tunnelling=Tunnelling(set_point_A=1e-9)))[0]
    assert len(family.members) == len(loop_plant().family)
    for sampled, identified in zip(family.members, loop_plant().family, strict=True):
        frequency_Hz = np.array([10.0, 500.0, 5000.0])
        z = np.exp(-2j * np.pi * frequency_Hz / RATE_Hz)
        expected = identified.frequency_response(frequency_Hz)
        response = np.polyval(sampled.B[::-1], z) / np.polyval(sampled.A[::-1], z)
        assert response == pytest.approx(expected, rel=1e-9)


def test_the_family_has_the_declared_barriers_with_gains_by_their_root():
    gains = [member.gain for member in vertical_task(LOOP, LAB)[0].members]
    assert gains[-2] / gains[0] == pytest.approx(0.5)
    assert gains[-1] / gains[0] == pytest.approx(2.0)


def test_the_reading_noise_is_shot_resistor_and_converter_noise():
    """1 nA, 10 kHz, 1 GOhm, 16 bits over 20 V: 2.24 pA, 0.50 pA (20 C) and 0.088 pA."""
    noise_A = reading_noise_A(loop_plant().plant, LAB, "z")
    assert noise_A == pytest.approx(np.sqrt(2.243**2 + 0.504**2 + 0.0881**2) * 1e-12, rel=2e-3)


@pytest.mark.parametrize(
    ("lab", "line"),
    [
        (replace(LAB, tunnelling=Tunnelling()), r"`set_point_A = .*` under \[tunnelling\]"),
        (replace(LAB, acquisition=Acquisition()), r"`input_range_V = .*` under \[acquisition\]"),
    ],
)
def test_a_missing_declaration_is_named_by_its_line(lab, line):
    with pytest.raises(LabFileError, match=line):
        vertical_task(LOOP, lab)


TOP_V = 32767 * 20.0 / 65536  # highest code of 16 bits from -10 to 10 V


@pytest.mark.parametrize(
    ("gain", "output_V", "command_V", "unranged_V"),
    [
        (-10.0, (-20.0, 150.0), (-10.0, 2.0), (-15.0, 2.0)),
        (20.0, (-20.0, 150.0), (-1.0, 7.5), (-1.0, 7.5)),
        (None, (-20.0, 150.0), (-10.0, TOP_V), (-20.0, 150.0)),
        (20.0, (None, 150.0), (-10.0, 7.5), (-math.inf, 7.5)),
        (20.0, (-20.0, None), (-1.0, TOP_V), (-1.0, math.inf)),
    ],
)
def test_the_command_keeps_within_converter_and_amplifier(gain, output_V, command_V, unranged_V):
    """Limits hold when other entries are missing, also without the range of the converter."""
    amplifier = Amplifier(gain_V_per_V=gain, output_min_V=output_V[0], output_max_V=output_V[1])
    lab = replace(LAB, amplifier=amplifier)
    converters = converters_of(lab, "z")
    assert (converters.command_V, converters.command_step_V) == (command_V, 20.0 / 2**16)
    unranged = converters_of(replace(lab, acquisition=Acquisition(dac_bits=16)), "z")
    assert (unranged.command_V, unranged.command_step_V) == (unranged_V, 0.0)


def test_a_rig_without_a_common_voltage_and_a_gap_law_alone_are_refused(rng):
    amplifier = Amplifier(gain_V_per_V=1.0, output_min_V=20.0, output_max_V=150.0)
    with pytest.raises(LabFileError, match="no voltage in common"):
        vertical_task(LOOP, replace(LAB, amplifier=amplifier))
    law = fit_barrier([sweep(rng)]).law
    with pytest.raises(DesignError, match="dither"):
        vertical_task(TunnellingModel(gap_law=law, loop_plant=None), LAB)


def test_every_member_of_the_family_of_a_tip_holds_its_margins():
    model = ActuatorModel(stage="tip", axes={}, sources={}, tunnelling=LOOP)
    design = design_stage(model, model_digest="sha256:none", lab=LAB).axis("z")
    loop = design.recommended
    assert len(loop.margins) == len(loop_plant().family) + 2
    assert loop.worst_modulus_margin >= 0.5
    assert (loop.worst_delay_margin_s or np.inf) >= 1.0 / RATE_Hz
    assert design.specification.voltage_min_V == -10.0
