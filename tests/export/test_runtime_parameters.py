"""The exported parameters of a design give the designed loop in the runtime."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.varied_chains import plant_from_chain
from piezoid.design.certificate import Certificate
from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.design.feedforward import ReferencePath
from piezoid.design.observer import disturbance_model, linear_controller
from piezoid.design.plant import PlantFamily
from piezoid.design.sensitivity import margins
from piezoid.errors import ParameterFileError
from piezoid.export.export_stage import lateral_axis, observer_values, rst_values, tunnelling_axis
from piezoid.export.parameter_file import ParameterFile, from_json, to_json
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from tests.design.placed import place_observer
from tests.design.rig import lateral_chain, lateral_specification
from tests.reports.known_stage import axis_model
from tests.runtime.observer_design import poles
from tests.runtime.runtime_parameters import RST_R, RST_S, WIDE, started
from tests.verification.rig import WATCH, GAIN_m_per_V, RATE_Hz

GUARDS = {
    **WATCH,
    "current_reference_A": 1e-9,
    "current_floor_A": 1e-11,
    "current_ceiling_A": 1e-8,
    "retract_voltage_V": -10.0,
}


def design_plant(gain=GAIN_m_per_V):
    """Return the sampled lateral chain with a further sample of delay."""
    return plant_from_chain(lateral_chain(gain, 1.0 / RATE_Hz))


def placed_observer(oscillation_Hz=(), gain=GAIN_m_per_V, form="affine"):
    model = disturbance_model(RATE_Hz, oscillation_Hz)
    oscillator_poles = [poles(f, 0.7) for f in oscillation_Hz]
    return place_observer(
        design_plant(gain),
        feedback_poles=np.r_[poles(630, 0.9), poles([4e3, 8.5e3])],
        observer_poles=np.concatenate(
            [poles(1200, 0.8), poles([800, 4200, 8600]), *oscillator_poles]
        ),
        form=form,
        disturbance=model,
    )


def reference_loop(observer, reference, measured):
    """Return the voltages by the equations of the design, without limits."""
    x, w = np.zeros(len(observer.A)), np.zeros(len(observer.disturbance.output))
    c, volts = observer.disturbance.output, []
    for r, y in zip(reference, measured, strict=True):
        nu = y - observer.C @ x
        x, w = x + observer.state_gain * nu, w + observer.disturbance_gain * nu
        v = observer.reference_gain * r - observer.feedback_gain @ x - c @ w
        volts.append(v)
        x = observer.A @ x + observer.B * (v + c @ w)
        w = observer.disturbance.transition @ w
    return np.array(volts)


@pytest.mark.parametrize("oscillation_Hz", [(), (20.0,), (20.0, 60.0)])
@pytest.mark.parametrize("gain", [GAIN_m_per_V, -GAIN_m_per_V])
def test_the_runtime_runs_the_designed_observer(oscillation_Hz, gain, rng):
    observer = placed_observer(oscillation_Hz, gain)
    reference, measured = rng.normal(0, 1e-7, (2, 300))
    parameters = {**WIDE, **observer_values(observer), "method": "dob", "polarity": np.sign(gain)}
    expected = reference_loop(observer, reference, measured)
    voltage_V = started(parameters).run(reference, measured).voltage_V
    assert np.abs(voltage_V - expected).max() < 1e-9 * np.abs(expected).max()


def test_a_disturbance_without_a_constant_is_refused():
    model = disturbance_model(RATE_Hz)
    fading = replace(model, transition=0.9 * model.transition)
    with pytest.raises(ParameterFileError, match="constant"):
        observer_values(replace(placed_observer(), disturbance=fading))


def test_the_integrator_is_factored_out_of_s_and_required():
    values = rst_values(3 * RST_R, 3 * RST_S, 3 * RST_R.sum(keepdims=True), np.ones(1))
    assert np.convolve(values["rst_S"], [1, -1]) == pytest.approx(RST_S, abs=1e-9)
    assert values["rst_R_V"] == pytest.approx(RST_R)
    assert values["rst_T_V"] == pytest.approx(RST_R.sum())
    with pytest.raises(ParameterFileError, match="integrator"):
        rst_values(RST_R, RST_S + 1e-6, RST_R, np.ones(1))


def path():
    f = np.array([2.0, -1.5, 0.75, -0.25])
    return ReferencePath(
        filter=f, preview_samples=4, band_Hz=100.0, error=0.0, worst_error=0.0, plain_error=0.0
    )


def loop_design(method, R, S, T, *, gain=GAIN_m_per_V, observer=None, certificate=None):
    members = PlantFamily(members=(design_plant(gain),)).fractions
    return LoopDesign(
        method=method,
        observer=observer,
        bandwidth_Hz=90.0,
        R=R,
        S=S,
        T=T,
        A_0=np.ones(1),
        reference=path(),
        margins=tuple(margins(member, R, S) for member in members),
        rejections=(),
        certificate=certificate,
        candidates=(),
        members=members,
    )


def axis_design(*loops, axis="x", voltage_V=(0.0, 10.0)):
    low, high = voltage_V
    specification = replace(
        lateral_specification(),
        voltage_min_V=low,
        voltage_max_V=high,
        voltage_step_V=(high - low) / 65536,
    )
    return AxisDesign(axis=axis, output_unit="m", specification=specification, loops=loops)


def design(gain=GAIN_m_per_V, certificate=None):
    loops = []
    for method, form in {"mpi_dob": "inverse", "dob": "affine"}.items():
        observer = placed_observer(gain=gain, form=form)
        linear = linear_controller(observer)
        loops.append(
            loop_design(
                *(method, linear.R, linear.S, linear.T),
                gain=gain,
                observer=observer,
                certificate=certificate,
            )
        )
    return axis_design(*loops)


def model(polarity=1):
    zones = DeadZones(threshold=np.array([-1e-6, 0, 2e-6]), weight=np.array([0.1, 1.0, -0.1]))
    plays = PrandtlIshlinskii(
        threshold=np.array([0.0, 1, 2, 3]), weight=GAIN_m_per_V * np.array([0.7, 0.1, 0.1, 0.1])
    )
    hysteresis = ModifiedPrandtlIshlinskii(
        plays=plays, dead_zones=zones, voltage_offset_V=5.0, displacement_offset_m=1e-5
    )
    return replace(axis_model(), polarity=polarity, hysteresis=hysteresis, starts=())


def test_an_axis_ships_its_recommended_loop_with_alternatives():
    axis = lateral_axis(model(), design(), {"stuck_samples": 100, "stuck_voltage_V": 0.1})
    assert axis.methods == ("mpi_dob", "dob", "mpi", "none")
    assert axis.values["preview_samples"] == 4
    assert axis.for_method("none").values["preview_samples"] == 0
    assert axis.values["stuck_samples"] == 100
    low, high = (float(axis.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    assert high - low == pytest.approx(10 * GAIN_m_per_V, rel=0.2)
    file = ParameterFile(name="stage", axes=(axis,))
    assert to_json(from_json(to_json(file), "params.json")) == to_json(file)


def test_the_certified_step_ships_only_with_a_guarantee():
    def shipped(is_guaranteed):
        certificate = Certificate(
            form="inverse",
            increment_gain=0.3,
            loop_peak=2.0,
            small_gain=0.6 if is_guaranteed else 1.2,
            is_guaranteed=is_guaranteed,
            hysteresis_error_m=1e-8,
            reference_error_m=1e-8,
            converter_error_m=1e-9,
            guaranteed_error_m=2.1e-8,
            noise_error_m=3e-9,
            reference_slew_m_per_s=2e-3,
            worst_member="nominal",
            conditions=(),
        )
        return lateral_axis(model(), design(certificate=certificate)).values["certified_step_m"]

    assert shipped(True) == pytest.approx(2e-3 / RATE_Hz)
    assert shipped(False) == 0.0


@pytest.mark.parametrize("polarity", [1, -1])
def test_the_exported_inverse_is_that_of_the_model(polarity):
    axis = lateral_axis(model(polarity), design(polarity * GAIN_m_per_V))
    mpi = axis.for_method("mpi").with_values({"lsb_V": 0.0, "reference_step_m": 0.0})
    operator = model().operator
    u = np.r_[np.linspace(5, 9, 20), np.linspace(9, 1, 40), np.linspace(1, 6, 25)]
    displacement_m, _ = operator.run(u, operator.virgin_memory())
    y = 1e-5 + polarity * (displacement_m - 1e-5)
    assert np.abs(started(mpi.values, 5.0, np.nan).run(y, y).voltage_V - u).max() < 1e-10


def test_a_design_of_another_direction_or_without_observer_is_refused():
    with pytest.raises(ParameterFileError, match="direction"):
        lateral_axis(model(-1), design())
    mpi_dob, dob = design().loops
    with pytest.raises(ParameterFileError, match="observer"):
        lateral_axis(model(), axis_design(replace(mpi_dob, observer=None), dob))


def test_a_tip_ships_its_guards_and_polynomials():
    loop = loop_design("rst", RST_R, RST_S, RST_R.sum(keepdims=True))
    vertical = axis_design(loop, axis="z", voltage_V=(-10.0, 10.0))
    axis = tunnelling_axis(vertical, GUARDS)
    assert axis.method == "rst"
    assert axis.values["current_ceiling_A"] == 1e-8
    assert axis.values["reference_section_count"] == 2
    for letter, polynomial in (("R", RST_R), ("T", RST_R.sum(keepdims=True))):
        count = int(axis.values[f"rst_{letter}_count"])
        assert axis.values[f"rst_{letter}_V"][:count] == pytest.approx(polynomial)
