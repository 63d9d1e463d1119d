"""Convert a model and a design to the parameter file of all axes that can ship.

The model's operator and the design's loops get the runtime's parameter names. Design and runtime
differ in two points. In the runtime, the constant disturbance is a separate state, and oscillators
are states of the observer. The runtime stores S without its integrator, which is then exact in
every precision.
"""

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.certificate import useful_bound_m
from piezoid.design.design import AxisDesign, Design, LoopDesign
from piezoid.design.feedforward import ReferencePath, filter_sections
from piezoid.design.junction_task import loop_plant_of
from piezoid.design.observer import DisturbanceObserver, with_oscillators_as_states
from piezoid.design.rst import LIGHT
from piezoid.errors import ParameterFileError, PiezoidError
from piezoid.export.parameter_file import AxisParameters, Decoupled, ParameterFile, Robustness
from piezoid.export.tip_guards import tip_guards
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.numerics.polynomial import roots_of
from piezoid.operators.preisach_plays import PreisachPlays
from piezoid.records.lab import Lab
from piezoid.runtime.library import complete
from piezoid.runtime.schema import MAX_RELAXATIONS

Values = dict[str, ArrayLike | str]

# |S(1)| relative to the sum of magnitudes, up to which S has an integrator, by rounding.
_INTEGRATOR = 1e-9
_MIN_CREEP_SHARE = 1e-6  # smaller shares of creep are dropped

# Distance of a measurement from the reachable range, relative to it, beyond which it is limited.
_MEASUREMENT_MARGIN = 0.25
# Shortest time in which a reference may cross the reachable range: no amplifier follows a jump in
# one sample. A ramp of duration T excites a mode with an amplitude of 2 / (w T) of the ramp, which
# is a tenth for T = 20 / w. More than 4 ms would limit a spiral at 100 Hz.
_MIN_RANGE_s, _MAX_RANGE_s = 1e-3, 4e-3
_RINGING = 20.0
# A sensor is stuck if its reading does not change for this time while the drive moves by this
# share of its range.
_STUCK_s = 1e-3
_STUCK_SHARE = 0.02
# Time for which the observer runs on the model alone: five times the sensor loss of 20 ms in
# verification, and short enough for creep, which it does not see, to remain small.
_BLIND_s = 0.1
_DECAYED = 0.01  # of its initial size: a transient is then over


def export_stage(
    model: ActuatorModel, design: Design, *, design_digest: str, lab: Lab | None = None
) -> ParameterFile:
    """Return the parameters of each designed axis: the recommended loop, and alternative methods.

    An axis that cannot ship does not prevent the export of other axes; the file states the reason.

    design_digest  of the design's file, for the chain of digests
    lab            as for the design; the guards of a tip may differ

    Raises ``ParameterFileError`` if lab.toml declares another rig than the design was made for,
    and the first refusal if no axis can ship, for example ``LabFileError`` with the line to write
    for a tip without declared guards.
    """
    lab = lab or Lab()
    if lab.rig_digest != design.rig_digest:
        raise ParameterFileError(
            f"{lab.place} declares another rig than the design was made for",
            needed="the converters, amplifiers and set point of the design",
            remedy="Run `piezoid design` again, then everything that follows it.",
        )
    shipped: list[AxisParameters] = []
    refused: dict[str, PiezoidError] = {}
    for axis in design.axes:
        try:
            shipped.append(_export_axis(model, axis, lab))
        except PiezoidError as refusal:
            refused[axis.axis] = refusal
    if not shipped:
        raise next(iter(refused.values()))
    unshipped = {name: str(refusal) for name, refusal in refused.items()}
    decoupling, decoupled = design.decoupling, None
    if decoupling is not None and {axis.axis for axis in shipped} & set(decoupling.axes):
        decoupled = Decoupled(axes=decoupling.axes, matrix=decoupling.matrix)
    return ParameterFile(
        name=model.stage,
        axes=tuple(shipped),
        sources={
            "model": design.model_digest,
            "design": design_digest,
            "lab": lab.digest,
            "control": lab.control_digest,
        },
        unshipped={**design.refused, **unshipped},
        decoupled=decoupled,
    )


def _export_axis(model: ActuatorModel, design: AxisDesign, lab: Lab) -> AxisParameters:
    specification, rate_Hz = design.specification, design.sampling_rate_Hz
    if design.output_unit != "m":
        if model.tunnelling is None:
            raise ParameterFileError(
                f"axis {design.axis} regulates a current, and model.json has no junction",
                needed="the junction for which this controller was designed",
                remedy="Fit again with the recordings of the tip.",
            )
        loop = loop_plant_of(model.tunnelling)
        return tunnelling_axis(design, tip_guards(lab, specification, rate_Hz, loop))
    guards = {
        "blind_samples": max(round(_BLIND_s * rate_Hz), 1),
        "stuck_samples": max(round(_STUCK_s * rate_Hz), 1),
        "stuck_voltage_V": _STUCK_SHARE
        * (specification.voltage_max_V - specification.voltage_min_V),
    }
    return lateral_axis(model[design.axis], design, guards)


def lateral_axis(
    model: AxisModel, design: AxisDesign, guards: Mapping[str, ArrayLike | str] | None = None
) -> AxisParameters:
    """Return a position axis with its recommended loop, and all other methods as alternatives.

    guards  runtime parameters that are not part of the design: ``stuck_samples``, ...

    Feedforward alone (``none``, ``mpi``) has neither filter nor preview of the reference, which
    were fitted for a loop.
    """
    common = {
        **_limits(design),
        **_displacement_limits(model, design),
        **hysteresis_values(model),
        **creep_values(model, design.sampling_rate_Hz),
        **(guards or {}),
    }
    plant = design.recommended.members[0]
    gain_m_per_V = float(plant.B.sum() / plant.A.sum())
    if gain_m_per_V * model.polarity <= 0:
        raise ParameterFileError(
            f"axis {design.axis}: the design's plant moves {gain_m_per_V:.3g} m/V, the model's "
            f"polarity is {model.polarity}",
            needed="a design for the direction in which the stage moves",
            remedy="Design again from this model.",
        )
    loops = {}
    for loop in design.loops:
        if loop.observer is None:
            raise ParameterFileError(
                f"the loop of method {loop.method} has no observer",
                needed="a disturbance observer for a position axis",
                remedy="Use tunnelling_axis for a controller given as R, S and T.",
            )
        # The fastest change of the reference in a sample for which the error is bounded.
        certificate, step_m = loop.certificate, 0.0
        if certificate is not None and certificate.is_guaranteed:
            step_m = certificate.reference_slew_m_per_s / loop.members[0].sampling_rate_Hz
        loops[loop.method] = complete(
            {
                **common,
                "method": loop.method,
                "certified_step_m": step_m,
                **observer_values(loop.observer),
                **reference_values(loop.reference),
            }
        )
    gain = {"gain_m_per_V": loops[design.recommended.method]["gain_m_per_V"]}
    for method in ("mpi", "none"):
        loops[method] = complete({**common, **gain, "method": method})
    return AxisParameters(
        axis=design.axis,
        values=loops[design.recommended.method],
        alternatives=tuple(v for m, v in loops.items() if m != design.recommended.method),
        robustness=_robustness(
            design.recommended, useful_bound_m(design.recommended.certificate, model)
        ),
    )


def tunnelling_axis(design: AxisDesign, guards: Mapping[str, ArrayLike | str]) -> AxisParameters:
    """Return a tip axis with its recommended loop and its guards.

    guards  of ``tip_guards``
    """
    loop = design.recommended
    values = {
        **_limits(design),
        **guards,
        **rst_values(loop.R, loop.S, loop.T, loop.A_0),
        **reference_values(loop.reference),
    }
    return AxisParameters(
        axis=design.axis, values=complete(values), robustness=_robustness(loop, None)
    )


def _robustness(loop: LoopDesign, guaranteed_error_m: float | None) -> Robustness:
    """Return the margins of a loop over its plant family.

    Closed-loop poles of magnitude rho decay to 1 % in ln(0.01) / ln(rho) samples; the reference
    filter adds its length.
    """
    radius = max(*(margin.spectral_radius for margin in loop.margins), _DECAYED)
    samples = math.log(_DECAYED) / math.log(radius) + len(loop.reference.filter) - 1
    slew_m_per_s = 0.0
    if guaranteed_error_m is not None and loop.certificate is not None:
        slew_m_per_s = loop.certificate.reference_slew_m_per_s
    return Robustness(
        delay_margin_s=loop.worst_delay_margin_s,
        transient_s=samples / loop.members[0].sampling_rate_Hz,
        guaranteed_error_m=guaranteed_error_m,
        reference_slew_m_per_s=slew_m_per_s,
    )


def _limits(design: AxisDesign) -> Values:
    specification, rate_Hz = design.specification, design.sampling_rate_Hz
    slew_V_per_s = specification.voltage_slew_V_per_s or 0.0
    return {
        "sampling_rate_Hz": rate_Hz,
        "voltage_step_V": slew_V_per_s / rate_Hz,
        "voltage_minimum_V": specification.voltage_min_V,
        "voltage_maximum_V": specification.voltage_max_V,
        "lsb_V": specification.voltage_step_V,
    }


def _displacement_limits(model: AxisModel, design: AxisDesign) -> Values:
    """Return the limits of references and measurements, from the model within voltage limits."""
    specification, operator = design.specification, model.operator
    extremes_V = np.array(
        [specification.voltage_min_V, specification.voltage_max_V, specification.voltage_min_V]
    )
    displacement_m, _ = operator.run(extremes_V, operator.virgin_memory())
    offset = operator.displacement_offset_m
    extremes_m = offset + model.polarity * (displacement_m - offset)
    low, high = float(extremes_m.min()), float(extremes_m.max())
    margin = _MEASUREMENT_MARGIN * (high - low)
    rate_Hz = design.sampling_rate_Hz
    s = np.log(roots_of(design.recommended.members[0].A)) * rate_Hz
    light = s[-s.real < LIGHT * np.abs(s)]
    ramp_s = _MIN_RANGE_s
    if light.size:
        ramp_s = _RINGING / float(np.abs(light).min())
        ramp_s = float(np.clip(ramp_s, _MIN_RANGE_s, _MAX_RANGE_s))
    slew_m_per_s = (high - low) / ramp_s
    if specification.voltage_slew_V_per_s is not None:
        amplifier_m_per_s = (
            (high - low) * specification.voltage_slew_V_per_s / float(np.ptp(extremes_V))
        )
        slew_m_per_s = min(slew_m_per_s, amplifier_m_per_s)
    return {
        "reference_step_m": slew_m_per_s / rate_Hz,
        "reference_minimum_m": low,
        "reference_maximum_m": high,
        "displacement_minimum_m": low - margin,
        "displacement_maximum_m": high + margin,
    }


def hysteresis_values(model: AxisModel) -> Values:
    """Return the model's operator under the runtime's names, in the de-poled state."""
    operator = model.operator
    if isinstance(operator, PreisachPlays):
        return {"polarity": model.polarity, **function_values(operator)}
    zones, envelope = operator.dead_zones, operator.envelope
    return {
        "polarity": model.polarity,
        "voltage_offset_V": operator.voltage_offset_V,
        "displacement_offset_m": operator.displacement_offset_m,
        "play_count": len(operator.plays.threshold),
        "play_threshold_V": operator.plays.threshold,
        "play_weight_m_per_V": operator.plays.weight,
        "play_memory_V": operator.virgin_memory(),
        "edge_count": 0,
        "knot_count": len(zones.threshold),
        "knot_m": zones.threshold,
        "knot_weight": zones.weight,
        "envelope_count": len(envelope.threshold),
        "envelope_knot_V": envelope.threshold,
        "envelope_weight": envelope.weight,
    }


def function_values(operator: PreisachPlays) -> Values:
    """Return plays behind functions under the runtime's names, in the de-poled state."""
    width_V = operator.edge_V[1] - operator.edge_V[0]
    return {
        "voltage_offset_V": operator.voltage_offset_V,
        "displacement_offset_m": operator.displacement_offset_m,
        "play_count": len(operator.threshold_V),
        "play_threshold_V": operator.threshold_V,
        "edge_count": len(operator.edge_V),
        "edge_steps": round(width_V / operator.step_V),
        "edge_V": operator.edge_V[0],
        "play_value_m": operator.value_m,
    }


def creep_values(model: AxisModel, sampling_rate_Hz: float) -> Values:
    """Return the model's creep under the runtime's names; empty if it has none.

    Model and runtime have the same equations: y = m + sum of c_i q_i, where q_i changes by
    (1 - exp(-T / tau_i)) (m - q_i) per sample. If the model has more elements than the runtime,
    those with the largest shares are kept.
    """
    rungs = [
        (share, time_s)
        for extension in model.extensions
        if isinstance(extension, CreepLadder)
        for time_s, share in zip(extension.time_s, extension.share, strict=True)
        if share > _MIN_CREEP_SHARE
    ]
    if not rungs:
        return {}
    selected = sorted(sorted(rungs, reverse=True)[:MAX_RELAXATIONS], key=lambda rung: rung[1])
    share, time_s = np.array(selected).T
    return {
        "relaxation_count": len(selected),
        "relaxation_share": share,
        "relaxation_rate": -np.expm1(-1.0 / (time_s * sampling_rate_Hz)),
    }


def observer_values(observer: DisturbanceObserver) -> Values:
    """Return the observer's gains under the runtime's names, oscillators among its states.

    If the displacement falls as the drive rises, its sign is reversed, as in the runtime.
    """
    transition, output = observer.disturbance.transition, observer.disturbance.output
    is_coupled = transition[0, 1:].any() or transition[1:, 0].any()
    if transition[0, 0] != 1.0 or output[0] != 1.0 or is_coupled:
        raise ParameterFileError(
            "the observer's first disturbance state is not a constant",
            needed="a constant first, then oscillators",
            remedy="Design with piezoid.design.observer.disturbance_model.",
        )
    o = with_oscillators_as_states(observer)
    rest_state = np.linalg.solve(np.eye(len(o.A)) - o.A, o.B)
    gain = float(o.C @ rest_state)
    sign = float(np.sign(gain))
    return {
        "observer_order": len(o.A),
        "observer_A": o.A,
        "observer_B": o.B,
        "observer_C": sign * o.C,
        "observer_L": sign * o.state_gain,
        "observer_disturbance_L_V_per_m": sign * float(o.disturbance_gain[0]),
        "observer_rest": rest_state,
        "feedback_K_V": o.feedback_gain,
        "feedback_N_V_per_m": sign * o.reference_gain,
        "gain_m_per_V": sign * gain,
    }


def reference_values(path: ReferencePath) -> Values:
    """Return filter and preview under the runtime's names."""
    sections = filter_sections(path.filter)
    return {
        "reference_section_count": len(sections),
        "reference_section": sections,
        "preview_samples": path.preview_samples,
    }


def rst_values(R: Array, S: Array, T: Array, antiwindup: Array) -> Values:
    """Return S u = T r - R y and A_0 under the runtime's names, S divided by 1 - q^-1.

    Raises ``ParameterFileError`` if S has no integrator.
    """
    share = abs(float(S.sum())) / float(np.abs(S).sum())
    if share > _INTEGRATOR:
        raise ParameterFileError(
            f"S(1) is {S.sum():.3g}, {share:.1e} of its coefficients",
            needed="a controller with an integrator, S(1) = 0",
            remedy="Put 1 - q^-1 among the fixed parts of S.",
        )
    quotient = np.cumsum(S)[:-1] / S[0]
    return {
        "method": "rst",
        "rst_T_count": len(T),
        "rst_T_V": T / S[0],
        "rst_R_count": len(R),
        "rst_R_V": R / S[0],
        "rst_S_count": len(quotient),
        "rst_S": quotient,
        "rst_A0_count": len(antiwindup),
        "rst_A0": antiwindup,
    }
