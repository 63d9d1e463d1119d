"""Limits of lab.toml hold when other entries are missing."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.design_stage import AxisDesignResult, design_of, design_stage
from piezoid.design.specification import converters_of
from piezoid.errors import PiezoidError
from piezoid.export.export_stage import export_stage
from piezoid.records.lab import Acquisition, Amplifier, Lab, Sensor
from piezoid.records.lab_tables import AxisRig
from piezoid.runtime.library import PRECISIONS
from tests.design.designed import known_design
from tests.runtime.runtime_parameters import started
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

pytestmark = pytest.mark.usefixtures("brief_designs")


def design_with(lab: Lab):
    return design_stage(
        fitted(), model_digest="", sampling_rate_Hz=RATE_Hz, lab=lab, forms=("inverse",)
    )


def test_no_output_exceeds_the_highest_code_of_the_converter():
    """Sixteen bits from -10 to 10 V end at 32767 steps, although the recordings reach 10 V."""
    step_V = 20.0 / 65536
    lab = Lab(acquisition=Acquisition(dac_bits=16, input_range_V=(-10.0, 10.0)))
    design = design_with(lab)
    assert design.axis("x").specification.voltage_max_V == 32767 * step_V
    parameters = export_stage(fitted(), design, design_digest="", lab=lab).axis("x").values
    for precision in PRECISIONS:
        controller = started(parameters, 5.0, precision=precision)
        run = controller.run(np.full(500, 1.0), np.zeros(500))
        assert round(run.voltage_V.max() / step_V) == 32767


def test_limits_of_an_amplifier_without_a_gain_are_kept():
    amplifier = Amplifier(slew_V_per_s=0.001, output_min_V=4.0, output_max_V=5.0)
    lab = Lab(amplifier=amplifier)
    assert converters_of(lab, "x").command_slew_V_per_s == 0.001
    with pytest.raises(PiezoidError, match="from 4 to 5 V"):
        design_with(lab)


def test_entries_without_effect_on_the_controller_are_reported():
    acquisition = Acquisition(adc_bits=16, input_range_V=(-10.0, 200.0))
    lab = Lab(acquisition=acquisition, axes={"X": AxisRig(sensor=Sensor(gain_V_per_m=1e5))})
    outcomes = [AxisDesignResult(axis="x", design=known_design().axis("x"))]
    remarks = " ".join(design_of(outcomes, model_digest="", lab=lab).remarks)
    assert "[axis.X]" in remarks
    assert "adc_bits" in remarks
    complete_lab = replace(lab, sensor=Sensor(gain_V_per_m=1e5), axes={})
    assert not design_of(outcomes, model_digest="", lab=complete_lab).remarks
