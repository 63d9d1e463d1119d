"""A declared chain with what was measured: the phase is right where the loop will need it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from piezoid.design.chain import Section
from piezoid.design.dynamics_chain import measured_chain, response_of
from piezoid.design.from_junction import axis_of
from tests.design.rig import lateral_chain
from tests.design.test_from_model import one_mode


@pytest.mark.parametrize(("low_Hz", "at_Hz"), [(5.0, 100.0), (150.0, 150.0)])
def test_phases_agree_at_a_third_of_the_mode_or_where_the_band_begins(low_Hz, at_Hz):
    declared = replace(lateral_chain(), sections=(Section(frequency_Hz=4e3),))
    dynamics = one_mode(frequency_Hz=300.0, damping=0.04, delay_s=120e-6)
    # A sensor that nobody declared is no pure delay: at other frequencies the phases differ.
    slow = replace(dynamics.declared[1], frequency_Hz=150.0)
    dynamics = replace(dynamics, declared=(dynamics.declared[0], slow), band_Hz=(low_Hz, 1000.0))
    found = measured_chain(declared, dynamics)
    assert found.chain.sections[-1].frequency_Hz == 300.0

    def lead(frequency_Hz):
        late = np.exp(-2j * np.pi * frequency_Hz * found.chain.delay_s)
        without = response_of(replace(found.chain, delay_s=0.0), frequency_Hz)
        return np.angle(without * late / dynamics.response([frequency_Hz])[0, 0, 0])

    assert lead(at_Hz) == pytest.approx(0.0, abs=1e-9)
    assert abs(lead(50.0)) > 0.02
    ratio = dynamics.response([at_Hz])[0, 0, 0] / response_of(found.chain, at_Hz)
    assert found.gain_ratio == pytest.approx(abs(ratio))


def test_the_axis_of_a_junction_is_the_one_its_loop_names_or_z():
    for loop, axis in ((None, "z"), ("", "z"), ("w", "w")):
        plant = None if loop is None else SimpleNamespace(axis=loop)
        assert axis_of(SimpleNamespace(loop_plant=plant)) == axis
