"""Design task of an identified lateral axis: its family, its bounds, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from piezoid.design.design import SCHEMA, Design, design_from_json
from piezoid.design.design_stage import SpecificationText, design_stage
from piezoid.design.hysteresis_bounds import draw_replicates
from piezoid.design.lateral_task import LateralTask, lateral_task, plant_family, unseen
from piezoid.digests import seal, unseal
from piezoid.errors import DesignError, LabFileError, ParameterFileError
from piezoid.export.export_stage import export_stage
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.dynamics.bandwidth import unmeasured
from piezoid.identification.dynamics.modal import Filter, LinearDynamics
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel, Lag
from piezoid.numerics.polynomial import response, roots_of
from piezoid.operators.dead_zone import DeadZones
from piezoid.records.lab import Acquisition, Lab
from tests.identification.dynamics.stage import truth
from tests.reports.known_stage import axis_model, stage_model

pytestmark = pytest.mark.usefixtures("brief_designs")

RATE_Hz = 20e3
RIG = Rig(amplifier_bandwidth_Hz=4e3, sensor_bandwidth_Hz=8.5e3)
DIGEST = "sha256:" + "0" * 64


def rigged(**changes: object) -> AxisModel:
    return replace(axis_model(), rig=RIG, **changes)  # type: ignore[arg-type]


def stage(**changes: object) -> ActuatorModel:
    return replace(stage_model(rigged()), controller_rate_Hz=RATE_Hz, **changes)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def task() -> LateralTask:
    return lateral_task(rigged(), RATE_Hz)


@pytest.fixture(scope="module")
def default() -> Design:
    return design_stage(stage(), model_digest=DIGEST, forms=("inverse",))


def test_the_family_spans_the_interval_of_the_gain_and_the_slopes(task):
    uncertainty, bounds = rigged().uncertainty, task.bounds["affine"]
    relative_half_width = uncertainty.loading_half_m[-1] / abs(uncertainty.loading_m[-1])
    members = task.families["affine"].members
    ratios = [member.gain / members[0].gain for member in members]
    count = len(task.families["inverse"].members)
    assert max(ratios[:count]) == pytest.approx(1.0 + relative_half_width)
    assert min(ratios[:count]) == pytest.approx(1.0 - relative_half_width)
    assert ratios[count:] == pytest.approx([bounds.slope_min, bounds.slope_max])


def test_a_gain_with_an_interval_beyond_zero_keeps_its_sign_and_slopes():
    """The loading curve is uncertain by 160 % at its end, as for a real stage."""
    axis = rigged()
    uncertainty = replace(
        axis.uncertainty, loading_half_m=1.6 * np.abs(axis.uncertainty.loading_m)
    )
    family = plant_family(rigged(uncertainty=uncertainty), RATE_Hz)
    gains = [member.gain for member in family.members]
    min_slope, max_slope = axis.hysteresis.slope_sector_m_per_V
    assert min(gains) == pytest.approx(min_slope)
    assert max(gains) == pytest.approx(max_slope)


def test_the_plant_has_polarity_and_delay_of_the_model(task):
    assert plant_family(rigged(polarity=-1), RATE_Hz).nominal.gain < 0.0
    B = plant_family(rigged(lag=Lag(kind="delay", time_s=3.0 / RATE_Hz)), RATE_Hz).nominal.B
    assert np.flatnonzero(B)[0] - np.flatnonzero(task.families["inverse"].nominal.B)[0] == 3


def test_the_plant_has_mode_and_phase_of_identified_dynamics():
    """At a third of the mode, the sampled plant lags the dynamics by half a sample."""
    dynamics = one_mode(frequency_Hz=300.0, damping=0.04, delay_s=120e-6)
    axis = rigged(dynamics=dynamics)
    family = plant_family(axis, RATE_Hz)
    poles = roots_of(family.nominal.A)
    frequencies_Hz = np.abs(np.log(poles)) * RATE_Hz / (2.0 * np.pi)
    assert np.isclose(frequencies_Hz, 300.0, rtol=1e-6).sum() == 2
    nominal = family.nominal
    sampled = response(nominal.B, nominal.A, np.array([100.0]), RATE_Hz)[0]
    expected = dynamics.response([100.0])[0] * np.exp(-2j * np.pi * 100.0 * 0.5 / RATE_Hz)
    assert np.angle(sampled / expected) == pytest.approx(0.0, abs=1e-3)


def one_mode(*, frequency_Hz: float, damping: float, delay_s: float) -> LinearDynamics:
    min_slope, max_slope = axis_model().hysteresis.slope_sector_m_per_V
    return replace(
        truth(),
        mode_frequency_Hz=np.array([frequency_Hz]),
        mode_damping=np.array([damping]),
        mode_gain_m_per_V=np.array([0.5 * (min_slope + max_slope)]),
        delay_s=delay_s,
        declared=(
            Filter(name="amplifier", frequency_Hz=4e3),
            Filter(name="sensor", frequency_Hz=8.5e3),
        ),
        shape_covariance=np.diag([1e-4, 1e-4, 1e-12]),
        band_Hz=(5.0, 1000.0),
    )


def test_an_operator_with_an_envelope_has_bounds_and_families_in_both_forms():
    envelope = DeadZones(threshold=np.array([0.0, 2.0]), weight=np.array([1.0, -0.1]))
    axis = rigged(hysteresis=replace(axis_model().hysteresis, envelope=envelope))
    axis_task = lateral_task(axis, RATE_Hz)
    assert set(axis_task.bounds) == set(axis_task.families) == {"inverse", "affine"}
    min_slope, max_slope = axis.hysteresis.slope_sector_m_per_V
    affine = axis_task.bounds["affine"]
    assert affine.slope_min * affine.gain_m_per_V == pytest.approx(min_slope)
    assert affine.slope_max * affine.gain_m_per_V == pytest.approx(max_slope)


def test_replicates_scatter_by_the_stated_uncertainty(rng):
    uncertainty = axis_model().uncertainty
    names = (*uncertainty.names, "envelope_weight[0]", "envelope_weight[1]")
    covariance = np.zeros((len(names), len(names)))
    covariance[:-2, :-2], covariance[-1, -1] = uncertainty.covariance, 0.02**2
    envelope = DeadZones(threshold=np.array([0.0, 2.0]), weight=np.array([1.0, -0.1]))
    axis = rigged(
        hysteresis=replace(axis_model().hysteresis, envelope=envelope),
        uncertainty=replace(
            uncertainty,
            names=names,
            values=np.r_[uncertainty.values, 1.0, -0.1],
            covariance=covariance,
        ),
    )
    replicates = draw_replicates(axis, rng)
    assert all(operator.is_invertible for operator in replicates)
    assert {float(operator.envelope.weight[0]) for operator in replicates} == {1.0}
    # 200 draws determine a standard deviation to 5 %; the tolerance is five times that.
    assert np.std([o.envelope.weight[1] for o in replicates]) == pytest.approx(0.02, rel=0.25)
    index = uncertainty.names.index("play_weight_m_per_V[0]")
    expected = np.sqrt(uncertainty.covariance[index, index])
    assert np.std([o.plays.weight[0] for o in replicates]) == pytest.approx(expected, rel=0.25)


def test_an_axis_without_a_pole_is_refused_with_the_known_facts():
    unknown = unmeasured(300.0, "nothing was recorded")
    visible = replace(unknown, kind="resonance", peak_ratio=12.0, peak_Hz=280.0)
    verdicts = (
        (r"no pole is declared.*bandwidth_Hz of \[amplifier\]", axis_model().bandwidth),
        (r"bandwidth_Hz = 300 of \[actuator\] does not suffice", unknown),
        ("near 280 Hz", visible),
    )
    for words, verdict in verdicts:
        with pytest.raises(DesignError, match=words):
            plant_family(replace(axis_model(), bandwidth=verdict), RATE_Hz)


def test_the_assumed_first_mode_is_below_a_recorded_resonance():
    unknown = unmeasured(None, "nothing was recorded")
    visible = replace(unknown, kind="resonance", peak_ratio=12.0, peak_Hz=110.0)
    stated = replace(visible, stated_Hz=630.0)
    limits_Hz = [
        unseen(replace(axis_model(), bandwidth=verdict)).from_Hz
        for verdict in (unknown, replace(unknown, stated_Hz=660.0), visible, stated)
    ]
    assert limits_Hz == pytest.approx([200.0, 600.0, 100.0, 100.0])


@pytest.mark.parametrize(
    ("model", "words"),
    [
        (stage_model(rigged()), r"sampling_rate_Hz under \[acquisition\]"),
        (
            stage_model(axis_model()),
            r"the fit had no sampling rate of the controller, and no pole.*bandwidth_Hz",
        ),
        (stage(axes={}), "the model contains no single axis"),
        (
            replace(
                stage_model(axis_model(reason="it opens the wrong way")), controller_rate_Hz=1e4
            ),
            "does not apply, it opens the wrong way",
        ),
    ],
    ids=["no rate", "neither rate nor pole", "no axis", "another class"],
)
def test_a_stage_that_cannot_be_designed_is_refused_with_the_reason(model, words):
    with pytest.raises(DesignError, match=words):
        design_stage(model, model_digest=DIGEST)


def test_a_drive_recorded_outside_the_range_of_the_converter_is_refused():
    lab = Lab(acquisition=Acquisition(input_range_V=(-1.0, 1.0)))
    with pytest.raises(LabFileError, match=r"recorded from 0 to 10 V.*from -1 to 1 V"):
        design_stage(stage(), model_digest=DIGEST, lab=lab)


def test_the_default_design_holds_its_margins_and_is_guaranteed(default):
    loop = default.axis("x").recommended
    assert loop.method == "mpi_dob"
    assert loop.worst_modulus_margin >= 0.5
    assert (loop.worst_delay_margin_s or np.inf) >= 1.0 / RATE_Hz
    assert loop.certificate is not None
    assert loop.certificate.is_guaranteed


def test_a_delay_longer_than_the_states_of_the_controller_is_designed():
    lag = Lag(kind="delay", time_s=1.5e-3)
    late_stage = replace(stage_model(rigged(lag=lag)), controller_rate_Hz=RATE_Hz)
    design = design_stage(late_stage, model_digest=DIGEST, forms=("inverse",))
    (loop,) = design.axes[0].loops
    assert all(len(member.B) > 30 for member in loop.members)  # the family keeps its delay
    assert all(member.is_stable and member.modulus_margin >= 0.5 for member in loop.margins)
    values = export_stage(late_stage, design, design_digest=DIGEST).axes[0].values
    assert values["observer_order"] == 16


def test_an_unrecorded_first_mode_limits_the_loop(default):
    """A first mode of quality 60 at 200 Hz or above keeps the loop stable."""
    recommended = default.axes[0].recommended
    nominal = recommended.members[0]
    s = 2j * np.pi * np.geomspace(1.0, 9e3, 4000)
    z = np.exp(s / RATE_Hz)
    for mode_Hz in (200.0, 300.0, 640.0, 1500.0):
        w = 2.0 * np.pi * mode_Hz
        peak = np.abs(w**2 / (s**2 + s * w / 60.0 + w**2))
        loop = np.abs(
            np.polyval(nominal.B[::-1], 1.0 / z)
            / np.polyval(nominal.A[::-1], 1.0 / z)
            * np.polyval(recommended.R[::-1], 1.0 / z)
            / np.polyval(recommended.S[::-1], 1.0 / z)
        )
        beyond = np.abs(s) > 0.9 * w
        assert (loop * peak)[beyond].max() < 1.0


def test_a_loop_with_damping_tolerates_a_second_mode_beyond_the_recordings():
    """The small gain holds for a second mode of 1.9 times the static gain beyond the band."""
    dynamics = one_mode(frequency_Hz=630.0, damping=0.037, delay_s=50e-6)
    design = design_stage(
        stage(axes={"x": rigged(dynamics=dynamics)}), model_digest=DIGEST, forms=("inverse",)
    )
    loop = design.axes[0].recommended
    assert loop.bandwidth_Hz > 0.16 * 630.0  # the loop damps the mode
    z = np.exp(2j * np.pi * np.linspace(1000.0, 0.49 * RATE_Hz, 4000) / RATE_Hz)
    for plant in plant_family(rigged(dynamics=dynamics), RATE_Hz).members:
        b, a, r, s = (np.polyval(p[::-1], 1.0 / z) for p in (plant.B, plant.A, loop.R, loop.S))
        effort_per_m = np.abs(a * r / (a * s + b * r))
        assert (1.9 * abs(plant.gain) * effort_per_m).max() < 1.0


def test_a_declared_resonance_permits_a_faster_loop():
    declared = rigged(bandwidth=unmeasured(12e3, "nothing was recorded"))
    slow, fast = (
        lateral_task(axis, RATE_Hz, forms=("inverse",)).specification
        for axis in (rigged(), declared)
    )
    assert slow.bandwidth_Hz < 5.0 < 100.0 < fast.bandwidth_Hz


def test_axes_that_cannot_be_designed_are_reported_and_the_others_designed():
    """Axis w has another model class, and axis y an infeasible bandwidth."""
    inapplicable = replace(axis_model(reason="it opens the wrong way"), axis="w")
    demanding = rigged(axis="y", bandwidth=unmeasured(12e3, "nothing was recorded"))
    design = design_stage(
        stage(axes={"w": inapplicable, "x": rigged(), "y": demanding}),
        model_digest=DIGEST,
        requested=SpecificationText(text="[y]\nbandwidth_Hz = 4000\n"),
        forms=("inverse",),
    )
    assert [axis.axis for axis in design.axes] == ["x"]
    (remark,) = design.remarks
    assert "axis w: the model class does not apply" in remark
    assert "axis y, bandwidth 4000 Hz" in design.refused["y"]
    assert "Ask for bandwidth_Hz" in design.refused["y"]
    read = design_from_json(design.to_json())
    assert (read.remarks, read.refused) == (design.remarks, design.refused)


def test_a_design_without_the_field_refused_is_read(default):
    record = unseal(default.to_json(), SCHEMA, "design.json")
    fields = {k: v for k, v in record.items() if k not in ("schema", "digest", "refused")}
    assert design_from_json(seal(SCHEMA, fields)).refused == {}
    del fields["axes"]
    with pytest.raises(ParameterFileError, match="the fields are"):
        design_from_json(seal(SCHEMA, fields))
