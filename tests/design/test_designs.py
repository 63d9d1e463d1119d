"""Designs of axes: limits of every member, candidates, files, loops in scipy and control."""

import json
from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.certificate import certify
from piezoid.design.design import AxisDesign, Design, LoopDesign, design_from_json
from piezoid.design.feasibility import unmet
from piezoid.design.junction_task import design_vertical
from piezoid.design.lateral import design_lateral, with_sector
from piezoid.design.observer import linear_controller
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import margins, sensitivities
from piezoid.design.tuning import tune_observer
from piezoid.errors import DesignError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import delayed, product, spectral_radius, total
from tests.design.designed import known_design
from tests.design.rig import (
    SECTOR,
    LATERAL_m_per_V,
    RATE_Hz,
    lateral_family,
    lateral_model,
    lateral_specification,
    vertical_family,
    vertical_specification,
)


@pytest.fixture(scope="module")
def lateral() -> AxisDesign:
    family = lateral_family()
    return design_lateral(
        "x",
        {"inverse": family, "affine": with_sector(family, SECTOR)},
        lateral_specification(),
        model=lateral_model(),
        bounds={"affine": SECTOR},
    )


@pytest.fixture(scope="module")
def vertical() -> AxisDesign:
    return design_vertical("z", vertical_family(), vertical_specification())


def distance_and_sensitivity(family: PlantFamily, R: Array, S: Array) -> tuple[float, float]:
    """Return the smallest Nyquist distance and the largest |Syp| at 300 Hz over the family."""
    z = np.exp(1j * np.linspace(1e-4, np.pi, 40_001))
    distance = np.inf
    for plant in family.members:
        closed = total(product(plant.A, S), product(plant.B, R))
        assert spectral_radius(closed) < 1.0
        curve = np.polyval(closed[::-1], 1 / z) / np.polyval(product(plant.A, S)[::-1], 1 / z)
        distance = min(distance, float(np.abs(curve).min()))
    frequency_Hz = np.array([300.0])
    sensitivity = max(
        float(abs(sensitivities(m, R, S, frequency_Hz).Syp[0])) for m in family.members
    )
    return distance, sensitivity


def test_every_member_of_the_lateral_family_holds_both_margins(lateral):
    for loop in lateral.loops:
        assert loop.worst_modulus_margin >= 0.5
        assert loop.worst_delay_margin_s >= 1.0 / RATE_Hz
        distance, _ = distance_and_sensitivity(lateral_family(), loop.R, loop.S)
        assert distance >= 0.5
        for plant in lateral_family().members:
            delayed_loop = total(product(plant.A, loop.S), delayed(product(plant.B, loop.R), 1))
            assert spectral_radius(delayed_loop) < 1.0


def test_three_tenths_of_the_delay_margin_leave_most_of_the_modulus_margin(lateral):
    """The README of a bundle recommends at most this additional delay."""
    turn = np.linspace(1e-4, np.pi, 40_001)
    for loop in lateral.loops:
        worst = {0.0: np.inf, 0.3: np.inf}
        delay_s = min(margins(m, loop.R, loop.S).delay_margin_s for m in loop.members)
        for plant in loop.members:
            z = np.exp(1j * turn)
            curve = np.polyval(product(plant.B, loop.R)[::-1], 1 / z)
            curve /= np.polyval(product(plant.A, loop.S)[::-1], 1 / z)
            for share in worst:
                delayed_curve = curve * np.exp(-1j * turn * share * delay_s * RATE_Hz)
                worst[share] = min(worst[share], float(np.abs(1.0 + delayed_curve).min()))
        assert worst[0.3] > 0.6 * worst[0.0]


def test_both_forms_are_designed_and_the_inverse_is_recommended(lateral):
    assert [loop.method for loop in lateral.loops] == ["mpi_dob", "dob"]
    assert lateral.recommended.method == "mpi_dob"
    assert len(lateral.loop("dob").members) == len(lateral.recommended.members) + 2
    with pytest.raises(KeyError, match="no loop 'rst'"):
        lateral.loop("rst")


def test_the_best_feasible_candidate_is_selected_with_its_margins(lateral, vertical):
    names = [[c.name for c in loop.candidates] for loop in (*lateral.loops, *vertical.loops)]
    assert names == [["placed", "kalman"]] * 2 + [["band-stop", "convex"]]
    for loop in (*lateral.loops, *vertical.loops):
        (selected,) = (c for c in loop.candidates if c.is_chosen)
        assert selected.figure == min(c.figure for c in loop.candidates if c.is_feasible)
        np.testing.assert_array_equal(selected.R, loop.R)
        for member, reached in zip(loop.members, loop.margins, strict=True):
            assert margins(member, loop.R, loop.S) == reached
    assert loop.candidates[1].is_chosen  # convex shaping of the tip is the best here


def test_only_a_form_with_bounds_has_a_certificate_for_a_scan_over_the_reach(lateral):
    assert lateral.loop("mpi_dob").certificate is None
    loop, specification = lateral.loop("dob"), lateral_specification()
    amplitude_m = SECTOR.reach_V * LATERAL_m_per_V
    expected = certify(
        *(loop.members, loop.R, loop.S, loop.T),
        path=loop.reference,
        bounds=SECTOR,
        reference_slew_m_per_s=2.0 * np.pi * specification.scan_frequency_Hz * amplitude_m,
        voltage_step_V=specification.voltage_step_V,
        sensor_noise_rms_m=specification.sensor_noise_rms,
    )
    assert loop.certificate.is_guaranteed
    assert loop.certificate.guaranteed_error_m == pytest.approx(expected.guaranteed_error_m)
    assert any("bounds for tests" in sentence for sentence in loop.certificate.conditions)


def test_the_tuning_beats_the_published_hand_tuning(lateral):
    """The best published tuning with a margin of 0.5 has a sensitivity of 0.063 at 10 Hz."""
    at_10 = next(r for r in lateral.recommended.rejections if r.frequency_Hz == 10.0)
    assert at_10.nominal < 0.063
    assert at_10.nominal <= at_10.worst


def test_resonant_modes_remove_the_scan_frequency_and_keep_the_margins():
    family = lateral_family()
    specification = replace(
        lateral_specification(60.0), scan_frequency_Hz=20.0, resonant_harmonics=(1,)
    )
    tuned = tune_observer(family, specification, model=lateral_model())
    c = linear_controller(tuned.observer)
    assert not unmet(family.members, c.R, c.S, specification)
    frequency_Hz = np.array([20.0])
    assert abs(sensitivities(family.nominal, c.R, c.S, frequency_Hz).Syp[0]) <= 1e-6


def test_the_same_input_gives_the_same_bytes():
    def bytes_of() -> bytes:
        family = PlantFamily(members=lateral_family().members[:1])
        axis = design_lateral("x", {"inverse": family}, lateral_specification(40.0))
        return Design(axes=(axis,), model_digest="sha256:0").to_json()

    assert bytes_of() == bytes_of()


def test_every_barrier_height_holds_its_margins(vertical):
    """Barriers of 16:1 and gains of 4:1 have Ms <= 5.8 dB and 1.2 samples of delay."""
    loop = vertical.recommended
    assert max(m.modulus_peak_dB for m in loop.margins) <= 5.8
    assert loop.worst_delay_margin_s >= 1.2 / RATE_Hz
    distance, sensitivity = distance_and_sensitivity(vertical_family(), loop.R, loop.S)
    assert 20 * np.log10(1 / distance) <= 5.8
    assert sensitivity < 0.4  # 0.95 with the central design at the smallest gain


def test_a_design_comes_back_from_its_file_exactly(lateral, vertical):
    design = Design(axes=(lateral, vertical), model_digest="sha256:abc")
    content = design.to_json()
    assert json.loads(content)["schema"] == "piezoid.design/1"
    read = design_from_json(content)
    assert read.to_json() == content
    assert read.axis("z").recommended.margins == vertical.recommended.margins
    np.testing.assert_array_equal(read.axis("x").loops[0].observer.A, lateral.loops[0].observer.A)
    assert not read.axis("x").loops[0].R.flags.writeable
    with pytest.raises(KeyError, match="no axis 'w'"):
        read.axis("w")


FREQUENCY_Hz = np.array([1.0, 30.0, 400.0, 3000.0])


@pytest.fixture(scope="module")
def loop() -> LoopDesign:
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
