"""Specifications: defaults from the plant, tables of design.toml, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.plant import Plant, PlantFamily
from piezoid.design.specification import Specification, slowest_Hz, specifications_from_toml
from piezoid.errors import LabFileError
from tests.design.rig import (
    LATERAL_m_per_V,
    RATE_Hz,
    default_limits,
    lateral_chain,
    lateral_specification,
    vertical_chain,
)


def test_the_slowest_frequency_and_the_delay_are_the_chains():
    plant = plant_from_chain(lateral_chain())
    assert slowest_Hz(plant) == pytest.approx(630.0, rel=1e-9)
    # The sum of 1/w and 2 zeta/w, and half a sample of hold.
    expected_s = 39.79e-6 + 18.72e-6 + 25.26e-6 + 25e-6
    assert plant.rest_delay_s == pytest.approx(expected_s, rel=1e-3)
    delayed = plant_from_chain(lateral_chain(delay_s=70e-6))
    assert delayed.rest_delay_s == pytest.approx(expected_s + 70e-6, rel=1e-3)


def default_for(plant: Plant | None = None) -> Specification:
    member = plant or plant_from_chain(lateral_chain(LATERAL_m_per_V))
    return default_limits(PlantFamily(members=(member,)), disturbance_rms=1e-7)


def test_defaults_have_margins_and_at_most_ten_times_the_static_drive():
    specification = default_for()
    assert specification.modulus_margin == 0.5
    assert specification.delay_margin_s == pytest.approx(1.0 / RATE_Hz)
    assert specification.bandwidth_Hz == pytest.approx(94.5)
    assert specification.scan_frequency_Hz == pytest.approx(9.45)
    rejection, control = (
        specification.all_templates
    )  # dB over log f, and no limit beyond the knots
    frequency_Hz = specification.bandwidth_Hz * np.array([1.0, 0.1, 1.001])
    np.testing.assert_allclose(rejection.limit_dB(frequency_Hz), [-3.0, -23.0, np.inf])
    allowed_V_per_m = 10.0 ** (control.limit_dB([1e-3, 10.0, RATE_Hz / 2]) / 20.0)
    np.testing.assert_allclose(allowed_V_per_m, 10.0 / LATERAL_m_per_V)
    assert control.function == "Sup"


def test_a_fast_plant_is_limited_by_its_delay_unless_it_leads_at_rest():
    plant = plant_from_chain(vertical_chain())
    specification = default_for(plant)
    assert specification.bandwidth_Hz == pytest.approx(0.03 / plant.rest_delay_s)
    lateral = plant_from_chain(lateral_chain(LATERAL_m_per_V))
    lead = np.array([1.0, -np.exp(-2.0 * np.pi * 50.0 / RATE_Hz)])  # a zero at 50 Hz
    lateral = replace(lateral, B=np.convolve(lateral.B, lead))
    assert lateral.rest_delay_s < 0.0
    assert default_for(lateral).bandwidth_Hz == pytest.approx(0.15 * slowest_Hz(lateral))


def test_a_table_changes_only_its_keys_and_adds_templates():
    text = """
    [x]
    bandwidth_Hz = 120
    resonant_harmonics = [1, 3]
    [[x.template]]
    name = "mode"
    function = "Syp"
    frequency_Hz = [500, 800]
    upper_dB = [3, 3]
    """
    defaults = {"x": lateral_specification(), "y": lateral_specification()}
    specifications = specifications_from_toml(text, defaults)
    assert specifications["x"].bandwidth_Hz == 120
    assert specifications["x"].resonant_harmonics == (1, 3)
    assert specifications["x"].templates[-1].limit_dB([600.0])[0] == 3.0
    assert specifications["y"] == defaults["y"]
    assert specifications["x"].modulus_margin == defaults["x"].modulus_margin


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[w]\nbandwidth_Hz = 1", r"\[w\] is not an axis.*one of x"),
        ("[x]\nbandwith_Hz = 1", "unknown key 'bandwith_Hz'.*bandwidth_Hz"),
        ("[x]\nbandwidth_Hz = '1 kHz'", "'1 kHz'. Needed: a number in SI units"),
        ("[x]\nbandwidth_Hz = -1", "expected > 0"),
        ("[x]\nscan_frequency_Hz = 0", "scan_frequency_Hz is 0, expected > 0"),
        ("[x]\nbandwidth_Hz = 1e30", "bandwidth_Hz is 1e\\+30. Needed: at most 1e\\+06 Hz"),
        ("[x]\nscan_frequency_Hz = 1e8", "at most 1e\\+06 Hz"),
        ("[x]\nmodulus_margin = 2", "between 0 and 1"),
        ("[x]\nvoltage_min_V = 20", "cross"),
        ("[x]\nsensor_noise_rms = -1.0", "expected >= 0"),
        ("[x]\n[[x.template]]\nname = 'a'", "template: .*name, function"),
        ("[x\n", "not TOML"),
    ],
)
def test_an_invalid_specification_is_refused_by_name(text, message):
    with pytest.raises(LabFileError, match=message):
        specifications_from_toml(text, {"x": lateral_specification()})


@pytest.mark.parametrize(
    "line",
    [
        "bandwidth_Hz" + ".a" * 1000 + " = 1",
        "bandwidth_Hz = " + "9" * 9000,
        "bandwidth_Hz = " + "9" * 4000,
        "bandwidth_Hz = inf",
        "bandwidth_Hz = nan",
        "noise_limit_rms = nan",
        "noise_limit_rms = 0",
        "delay_margin_s = 5e-324",
        "sensor_noise_rms = 1e30",
        "disturbance_rms = 1e4",
        "x" * 1_000_000 + " = 1",
        "resonant_harmonics = [[]]",
        "resonant_harmonics = [1, 1.5]",
        "resonant_harmonics = [100000]",
        "resonant_harmonics = [1, 2, 3, 4, 5, 6, 7, 8, 9]",
        "resonant_harmonics = 'all'",
        "template = 1",
        "template = [1]",
        "template = [{name = 1, function = 2, frequency_Hz = 3, upper_dB = 4}]",
        "template = [{name = 'a', function = 'Syp', frequency_Hz = [[1]], upper_dB = ['b']}]",
        "template = [{name = 'a', function = 'Syp', frequency_Hz = [1e308, -1e308], upper_dB = "
        "[3, 3]}]",
        "template = [{name = 'a', function = 'Syp', frequency_Hz = [1, 2], upper_dB = [1e9, 3]}]",
        "template = [{name = 'a', function = 'Syp', frequency_Hz = [1, 1e31], upper_dB = [3, 3]}]",
        "template = [{name = 5, function = 'Syp', frequency_Hz = [1, 2], upper_dB = [3, 3]}]",
        "template = [{name = 'a', function = 'Syp', frequency_Hz = [], upper_dB = []}]",
    ],
    ids=range(25),
)
def test_a_hostile_specification_is_refused_with_a_short_message(line):
    with pytest.raises(LabFileError) as refusal:
        specifications_from_toml(f"[x]\n{line}\n", {"x": lateral_specification()})
    assert len(str(refusal.value)) < 3000
