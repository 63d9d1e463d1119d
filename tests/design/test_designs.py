"""Whole axes: every member of the family holds every limit, or the refusal says what would."""

import json
from dataclasses import replace

import numpy as np
import pytest

from piezoid.design import youla
from piezoid.design.design import (
    AxisDesign,
    Design,
    LoopDesign,
    design_from_json,
    members_of,
)
from piezoid.design.feasibility import at_feasible_bandwidth
from piezoid.design.hysteresis_bounds import HysteresisBounds
from piezoid.design.lateral import design_lateral, with_sector
from piezoid.design.observer_loop import linear_controller
from piezoid.design.plant import PlantFamily, plant_from_fraction
from piezoid.design.requirements import unmet
from piezoid.design.sensitivity import margins, sensitivities
from piezoid.design.shaping import shape
from piezoid.design.specification import Specification, default_specification
from piezoid.design.templates import Template
from piezoid.design.tuning import tune_observer
from piezoid.design.vertical import design_vertical
from piezoid.design.youla import optimise
from piezoid.errors import ParameterFileError, TemplateError
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import delayed, product, spectral_radius, total
from tests.design.rig import (
    LATERAL_m_per_V,
    RATE_Hz,
    lateral_family,
    lateral_model,
    lateral_specification,
    vertical_family,
    vertical_specification,
)

SECTOR = HysteresisBounds(
    form="affine",
    gain_m_per_V=LATERAL_m_per_V,
    slope_min=0.85,
    slope_max=1.15,
    error_m=1e-7,
    reach_V=3.0,
    conditions=("bounds for tests",),
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


def brute_force(family: PlantFamily, R: Array, S: Array) -> tuple[float, float]:
    """Return the smallest Nyquist distance and the largest |Syp| at 300 Hz over the family."""
    z = np.exp(1j * np.linspace(1e-4, np.pi, 40_001))
    distance = np.inf
    for plant in family.members:
        closed = total(product(plant.A, S), product(plant.B, R))
        assert spectral_radius(closed) < 1.0
        curve = np.polyval(closed[::-1], 1 / z) / np.polyval(product(plant.A, S)[::-1], 1 / z)
        distance = min(distance, float(np.abs(curve).min()))
    at = np.array([300.0])
    left = max(float(abs(sensitivities(m, R, S, at).Syp[0])) for m in family.members)
    return distance, left


def test_every_member_of_the_lateral_family_holds_both_margins(lateral):
    for loop in lateral.loops:
        assert loop.worst_modulus_margin >= 0.5
        assert loop.worst_delay_margin_s >= 1.0 / RATE_Hz
        distance, _ = brute_force(lateral_family(), loop.R, loop.S)
        assert distance >= 0.5
        for plant in lateral_family().members:
            late = total(product(plant.A, loop.S), delayed(product(plant.B, loop.R), 1))
            assert spectral_radius(late) < 1.0


def test_both_forms_are_designed_and_the_inverse_is_recommended(lateral):
    assert [loop.method for loop in lateral.loops] == ["mpi_dob", "dob"]
    assert lateral.recommended.method == "mpi_dob"
    assert len(lateral.loop("dob").members) == len(lateral.recommended.members) + 2
    with pytest.raises(KeyError, match="no loop 'rst'"):
        lateral.loop("rst")


def test_both_tunings_are_shown_and_one_is_chosen(lateral):
    for loop in lateral.loops:
        assert [c.name for c in loop.candidates] == ["placed", "kalman"]
        chosen = [c for c in loop.candidates if c.is_chosen]
        assert len(chosen) == 1
        feasible = [c.figure for c in loop.candidates if c.is_feasible]
        assert chosen[0].figure == min(feasible)
        np.testing.assert_array_equal(chosen[0].R, loop.R)


def test_the_polynomials_are_the_observers(lateral):
    for loop in lateral.loops:
        c = linear_controller(loop.observer)
        np.testing.assert_array_equal(c.R, loop.R)
        np.testing.assert_array_equal(c.S, loop.S)
        np.testing.assert_array_equal(c.T, loop.T)


def test_margins_in_the_record_are_recomputed_from_r_and_s(lateral, vertical):
    for loop in (*lateral.loops, *vertical.loops):
        for member, reached in zip(loop.members, loop.margins, strict=True):
            assert margins(member, loop.R, loop.S) == reached


def test_only_a_form_with_bounds_has_a_certificate(lateral):
    assert lateral.loop("mpi_dob").certificate is None
    certificate = lateral.loop("dob").certificate
    assert certificate.is_guaranteed
    assert certificate.guaranteed_error_m > 0
    assert any("bounds for tests" in sentence for sentence in certificate.conditions)


def test_the_chosen_tuning_beats_the_published_hand_tuning(lateral):
    """The best published tuning that holds a margin of 0.5 leaves 0.063 at 10 Hz, nominal."""
    at_10 = next(r for r in lateral.recommended.rejections if r.frequency_Hz == 10.0)
    assert at_10.nominal < 0.063
    assert at_10.nominal <= at_10.worst


def test_resonant_modes_remove_the_scan_frequency_and_keep_the_margins():
    family = lateral_family()
    asked = replace(lateral_specification(60.0), scan_frequency_Hz=20.0, resonant_harmonics=(1,))
    tuned = tune_observer(family, asked, model=lateral_model())
    c = linear_controller(tuned.observer)
    assert not unmet(family.members, c.R, c.S, asked)
    at = np.array([20.0])
    assert abs(sensitivities(family.nominal, c.R, c.S, at).Syp[0]) <= 1e-6


def test_the_noise_budget_is_held_or_refused():
    family = PlantFamily(members=lateral_family().members[:2])
    free = tune_observer(family, lateral_specification(40.0), model=lateral_model())
    asked = replace(lateral_specification(40.0), noise_limit_rms=0.8 * free.judgement.noise_rms)
    quiet = tune_observer(family, asked, model=lateral_model())
    c = linear_controller(quiet.observer)
    assert not unmet(family.members, c.R, c.S, asked)
    hopeless = replace(asked, noise_limit_rms=1e-3 * free.judgement.noise_rms)
    assert unmet(family.members, c.R, c.S, hopeless)[0].template == "noise budget"


def test_the_same_input_gives_the_same_bytes():
    def bytes_of() -> bytes:
        family = PlantFamily(members=lateral_family().members[:2])
        axis = design_lateral("x", {"inverse": family}, lateral_specification(40.0))
        return Design(axes=(axis,), model_digest="sha256:0").to_json()

    assert bytes_of() == bytes_of()


def test_every_barrier_height_holds_its_margins(vertical):
    """16:1 in barrier, 4:1 in gain: Ms <= 5.8 dB and 1.2 samples of delay for each."""
    loop = vertical.recommended
    assert max(m.modulus_peak_dB for m in loop.margins) <= 5.8
    assert loop.worst_delay_margin_s >= 1.2 / RATE_Hz
    distance, left = brute_force(vertical_family(), loop.R, loop.S)
    assert 20 * np.log10(1 / distance) <= 5.8
    assert left < 0.4  # the central design leaves 0.95 of it at the smallest gain


def test_both_ways_are_shown_and_the_convex_one_wins_here(vertical):
    stopped, convex = vertical.recommended.candidates
    assert (stopped.name, convex.name) == ("band-stop", "convex")
    assert convex.is_chosen
    assert convex.figure < stopped.figure


def test_shaping_only_the_nominal_plant_collapses_at_the_ends_of_the_family():
    family, asked = vertical_family(), vertical_specification()
    alone = PlantFamily(members=family.members[:1])
    start = shape(alone, asked)
    nominal = optimise(alone, asked, start.controller)
    c = nominal.controller
    assert not unmet(alone.members, c.R, c.S, asked)
    reached = [margins(member, c.R, c.S) for member in family.members]
    assert any(not m.is_stable or m.modulus_peak_dB > 10.0 for m in reached)


def test_each_convex_step_keeps_every_member_stable_and_gains():
    family, asked = vertical_family(), vertical_specification(200.0)
    start = shape(family, asked)
    found = optimise(family, asked, start.controller)
    assert (np.diff(found.history) < 0).all()
    assert found.history[0] == pytest.approx(start.rejection, rel=1e-2)
    assert found.excess_dB <= 0.0
    c = found.controller
    assert not unmet(family.members, c.R, c.S, asked)
    assert c.S[0] == 1.0
    assert abs(c.S.sum()) <= 1e-12  # the integrator is a factor
    assert abs(c.R @ (-1.0) ** np.arange(len(c.R))) <= 1e-12 * abs(c.R).max()


def test_what_a_convex_step_was_not_asked_it_meets_as_if_it_had_been(monkeypatch):
    alone, asked = PlantFamily(members=vertical_family().members[:1]), vertical_specification()
    start = shape(alone, asked).controller
    few = optimise(alone, asked, start, most_iterations=2)
    monkeypatch.setattr(youla, "_EVERY", 1)
    every = optimise(alone, asked, start, most_iterations=2)
    assert few.history == pytest.approx(every.history, rel=1e-4)
    assert few.excess_dB == pytest.approx(every.excess_dB, abs=1e-3)


def test_band_stops_meet_a_template_that_pole_placement_alone_cannot():
    family = PlantFamily(members=vertical_family().members[:1])
    quiet = Template(
        name="quiet",
        function="Syp",
        frequency_Hz=np.array([1000.0, 1100.0]),
        upper_dB=np.array([-2.0, -2.0]),
    )
    asked = replace(vertical_specification(60.0), modulus_margin=0.6, templates=(quiet,))
    plain = shape(family, asked, most_band_stops=0)
    found = shape(family, asked)
    assert plain.excess_dB > 1.0
    assert found.excess_dB <= 0.0
    assert {stop.part for stop in found.band_stops} == {"S"}
    assert all(990.0 < stop.frequency_Hz < 1110.0 for stop in found.band_stops)
    assert not unmet(family.members, found.controller.R, found.controller.S, asked)


def ends_of_the_family() -> PlantFamily:
    nominal, low, *_, high = vertical_family().members
    return PlantFamily(members=(nominal, low, high))


def refused(asked: Specification) -> TemplateError:
    with pytest.raises(TemplateError) as refusal:
        design_vertical("z", ends_of_the_family(), asked, taps=8)
    return refusal.value


def test_an_infeasible_bandwidth_is_refused_with_the_place_and_the_nearest_one():
    error = refused(vertical_specification(1500.0))
    numbers = error.numbers
    assert numbers["template"] in str(error)
    assert numbers["member"] in str(error)
    assert numbers["excess_dB"] > 0
    assert 300.0 < numbers["nearest_bandwidth_Hz"] < 1500.0
    assert f"bandwidth_Hz = {numbers['nearest_bandwidth_Hz']:g}" in str(error)
    assert error.exit_status == 4
    nearest = vertical_specification(numbers["nearest_bandwidth_Hz"])
    found = design_vertical("z", ends_of_the_family(), nearest, taps=8)
    assert not unmet(found.recommended.members, found.recommended.R, found.recommended.S, nearest)


def test_a_limit_no_bandwidth_can_meet_is_said_to_be_one():
    wall = Template(
        name="wall",
        function="Syp",
        frequency_Hz=np.array([1.0, 9e3]),
        upper_dB=np.array([-6.0, -6.0]),  # Bode's integral forbids it
    )
    error = refused(replace(vertical_specification(100.0), templates=(wall,)))
    assert "No bandwidth helps" in str(error)
    assert "relax 'wall' by" in str(error)
    assert error.numbers["nearest_bandwidth_Hz"] is None


@pytest.mark.parametrize(
    ("B", "A"),
    [
        ((0.0, 0.3), (1.0, -0.7)),  # one lag
        ((0.0, 0.5, 0.2), (1.0, -0.6, -0.07)),  # a negative pole, as fits give
        ((0.0, 0.0, 0.1, 0.02), (1.0, -0.9)),  # broken delay
    ],
)
def test_identified_fractions_are_designed_with_their_defaults(B, A):
    members = [
        plant_from_fraction(
            f"gain x{gain}",
            gain * LATERAL_m_per_V * np.array(B),
            A,
            sampling_rate_Hz=RATE_Hz,
            output_unit="m",
        )
        for gain in (1.0, 0.9, 1.1)
    ]
    family = PlantFamily(members=tuple(members))
    asked = default_specification(
        family.nominal,
        voltage_min_V=-10.0,
        voltage_max_V=10.0,
        sensor_noise_rms=1e-9,
        disturbance_rms=1e-7,
    )
    loop = design_lateral("x", {"inverse": family}, asked).recommended
    assert not unmet(loop.members, loop.R, loop.S, asked)
    assert loop.reference.error < 1e-3


def test_a_default_nobody_asked_for_gives_way_to_the_nearest_feasible():
    family = PlantFamily(members=lateral_family().members[:2])

    def design(asked: Specification) -> LoopDesign:
        return design_lateral("x", {"inverse": family}, asked).recommended

    loop = at_feasible_bandwidth(design, lateral_specification(900.0))
    assert 100.0 < loop.bandwidth_Hz < 900.0
    assert loop.worst_modulus_margin >= 0.5


def test_a_design_comes_back_from_its_file_exactly(lateral, vertical):
    design = Design(axes=(lateral, vertical), model_digest="sha256:abc")
    content = design.to_json()
    assert json.loads(content)["schema"] == "piezoid.design/1"
    again = design_from_json(content)
    assert again.to_json() == content
    assert again.axis("z").recommended.margins == vertical.recommended.margins
    np.testing.assert_array_equal(again.axis("x").loops[0].observer.A, lateral.loops[0].observer.A)
    assert not again.axis("x").loops[0].R.flags.writeable
    with pytest.raises(KeyError, match="no axis 'w'"):
        again.axis("w")


def test_a_changed_design_file_is_refused(vertical):
    content = Design(axes=(vertical,), model_digest="sha256:abc").to_json()
    with pytest.raises(ParameterFileError, match="digest"):
        design_from_json(content.replace(b"sha256:abc", b"sha256:abd"))


def test_members_of_a_family_keep_order_and_labels():
    labels = [member.label for member in members_of(vertical_family())]
    assert labels == ["1 eV", "0.25 eV", "0.5 eV", "2 eV", "4 eV"]
