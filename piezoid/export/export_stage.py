"""export_stage: a model and a design in, the parameter file of all axes that can ship out.

A model's operator and a design's loop are written under the runtime's names. Design and runtime
differ in two places. The runtime keeps the constant part of the disturbance by itself and
oscillators among the observer's states; and it keeps S without its integrator, which is then exact
in every precision.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.design import AxisDesign, Design, LoopDesign
from piezoid.design.feedforward import ReferencePath, filter_sections
from piezoid.design.junction_task import loop_plant_of
from piezoid.design.observer import DisturbanceObserver, with_oscillators_as_states
from piezoid.design.rst import LIGHT
from piezoid.errors import ParameterFileError, PiezoidError
from piezoid.export.parameter_file import AxisParameters, Decoupled, ParameterFile
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

# |S(1)| up to this part of the sum of magnitudes is an integrator with rounded coefficients.
_INTEGRATOR = 1e-9
_MIN_CREEP_SHARE = 1e-6  # a smaller share of creep is none

# A measurement farther beyond the reachable range, as a share of it, is limited.
_MEASUREMENT_MARGIN = 0.25
# A reference may cross the reachable range in this time at the fastest: a jump in one sample asks
# the amplifier for what no amplifier gives. A ramp of T leaves 2 / (w T) of itself ringing in a
# mode: a tenth where T is 20 / w. Above 4 ms a spiral at 100 Hz would be held back.
_MIN_RANGE_s, _MAX_RANGE_s = 1e-3, 4e-3
_RINGING = 20.0
# A sensor is stuck if it shows one number for so long while the drive moves by this share of its
# range.
_STUCK_s = 1e-3
_STUCK_SHARE = 0.02
# The observer runs on the model alone for so long: five times the loss of 20 ms that verification
# runs, and before creep, which grows with the logarithm of time, moves what it cannot see.
_BLIND_s = 0.1


def export_stage(
    model: ActuatorModel, design: Design, *, design_digest: str, lab: Lab | None = None
) -> ParameterFile:
    """Return the parameters of each designed axis: the recommended loop, and others to compare.

    An axis that cannot ship does not prevent the others; the file states the reason.

    design_digest  of the design's file, for the chain of digests
    lab            that of the design, but for what guards a tip

    Raises ``ParameterFileError`` where lab.toml declares another rig than the design was made for,
    and what stands in the way of the first axis where none can ship, as ``LabFileError`` with
    the line to write for a tip whose guards are not declared.
    """
    declared = lab or Lab()
    if declared.rig_digest != design.rig_digest:
        raise ParameterFileError(
            f"{declared.place} declares another rig than the design was made for",
            needed="the converters, amplifiers and set point of the design",
            remedy="Run `piezoid design` again, then everything that follows it.",
        )
    shipped: list[AxisParameters] = []
    refused: dict[str, PiezoidError] = {}
    for axis in design.axes:
        try:
            shipped.append(_axis(model, axis, declared))
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
            "lab": declared.digest,
            "control": declared.control_digest,
        },
        unshipped={**design.refused, **unshipped},
        decoupled=decoupled,
    )


def _axis(model: ActuatorModel, design: AxisDesign, lab: Lab) -> AxisParameters:
    specification = design.specification
    rate_Hz = design.recommended.members[0].sampling_rate_Hz
    if design.output_unit != "m":
        if model.tunnelling is None:
            raise ParameterFileError(
                f"axis {design.axis} regulates a current, and model.json has no junction",
                needed="the junction this controller was designed for",
                remedy="Fit again with the recordings of the tip.",
            )
        loop = loop_plant_of(model.tunnelling)
        return tunnelling_axis(design, tip_guards(lab, specification, rate_Hz, loop))
    watch = {
        "blind_samples": max(round(_BLIND_s * rate_Hz), 1),
        "stuck_samples": max(round(_STUCK_s * rate_Hz), 1),
        "stuck_voltage_V": _STUCK_SHARE
        * (specification.voltage_max_V - specification.voltage_min_V),
    }
    return lateral_axis(model[design.axis], design, watch)


def lateral_axis(
    model: AxisModel, design: AxisDesign, further: Mapping[str, ArrayLike | str] | None = None
) -> AxisParameters:
    """Return X or Y with its recommended loop, and every other method to compare it with.

    further  runtime parameters that are not part of the design: ``stuck_samples``, ...

    Feedforward alone (``none``, ``mpi``) takes the references as they are: filter and preview
    belong to the loop they were fitted for.
    """
    common = {
        **_limits(design),
        **_range(model, design),
        **hysteresis_values(model),
        **creep_values(model, design.recommended.members[0].sampling_rate_Hz),
        **(further or {}),
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
    loops = {loop.method: complete({**common, **_loop_values(loop)}) for loop in design.loops}
    gain = {"gain_m_per_V": loops[design.recommended.method]["gain_m_per_V"]}
    for method in ("mpi", "none"):
        loops[method] = complete({**common, **gain, "method": method})
    return AxisParameters(
        axis=design.axis,
        values=loops[design.recommended.method],
        alternatives=tuple(v for m, v in loops.items() if m != design.recommended.method),
    )


def tunnelling_axis(design: AxisDesign, guards: Mapping[str, ArrayLike | str]) -> AxisParameters:
    """Return Z with its recommended loop and its guards.

    guards  of ``tip_guards``
    """
    loop = design.recommended
    values = {
        **_limits(design),
        **guards,
        **rst_values(loop.R, loop.S, loop.T, loop.A_0),
        **reference_values(loop.reference),
    }
    return AxisParameters(axis=design.axis, values=complete(values))


def _loop_values(loop: LoopDesign) -> Values:
    if loop.observer is None:
        raise ParameterFileError(
            f"the loop of method {loop.method} has no observer",
            needed="a disturbance observer for X and Y",
            remedy="Use tunnelling_axis for a controller given as R, S and T.",
        )
    # The fastest change of the reference in a sample for which the error is bounded.
    certificate, step_m = loop.certificate, 0.0
    if certificate is not None and certificate.is_guaranteed:
        step_m = certificate.reference_slew_m_per_s / loop.members[0].sampling_rate_Hz
    return {
        "method": loop.method,
        "certified_step_m": step_m,
        **observer_values(loop.observer),
        **reference_values(loop.reference),
    }


def _limits(design: AxisDesign) -> Values:
    specification = design.specification
    rate_Hz = design.recommended.members[0].sampling_rate_Hz
    slew_V_per_s = specification.voltage_slew_V_per_s or 0.0
    return {
        "sampling_rate_Hz": rate_Hz,
        "voltage_step_V": slew_V_per_s / rate_Hz,
        "voltage_minimum_V": specification.voltage_min_V,
        "voltage_maximum_V": specification.voltage_max_V,
        "lsb_V": specification.voltage_step_V,
    }


def _range(model: AxisModel, design: AxisDesign) -> Values:
    """Return the limits of references and measurements, from the model between voltage limits."""
    specification, operator = design.specification, model.operator
    extremes_V = np.array(
        [specification.voltage_min_V, specification.voltage_max_V, specification.voltage_min_V]
    )
    displacement_m, _ = operator.run(extremes_V, operator.virgin_memory())
    offset = operator.displacement_offset_m
    reached = offset + model.polarity * (displacement_m - offset)
    low, high = float(reached.min()), float(reached.max())
    margin = _MEASUREMENT_MARGIN * (high - low)
    rate_Hz = design.recommended.members[0].sampling_rate_Hz
    # the shortest time in which a reference may cross the range of this plant
    s = np.log(roots_of(design.recommended.members[0].A)) * rate_Hz
    light = s[-s.real < LIGHT * np.abs(s)]
    ramp_s = _MIN_RANGE_s
    if light.size:
        needed_s = _RINGING / float(np.abs(light).min())
        ramp_s = float(np.clip(needed_s, _MIN_RANGE_s, _MAX_RANGE_s))
    fastest_m_per_s = (high - low) / ramp_s
    if specification.voltage_slew_V_per_s is not None:
        followed_m_per_s = (
            (high - low) * specification.voltage_slew_V_per_s / float(np.ptp(extremes_V))
        )
        fastest_m_per_s = min(fastest_m_per_s, followed_m_per_s)
    return {
        "reference_step_m": fastest_m_per_s / rate_Hz,
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
    """Return the model's creep under the runtime's names; nothing where it has none.

    The ladder of the model and that of the runtime are one: y = m + sum of c_i x_i, where x_i goes
    by 1 - exp(-T / tau_i) of what it is away from m. Of a ladder that is longer than the
    runtime's, the largest shares stay.
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

    A plant that falls as the drive rises is mirrored, as the runtime mirrors its displacement.
    """
    turn, output = observer.disturbance.transition, observer.disturbance.output
    if turn[0, 0] != 1.0 or output[0] != 1.0 or turn[0, 1:].any() or turn[1:, 0].any():
        raise ParameterFileError(
            "the observer's first disturbance state is no constant",
            needed="a constant first, then oscillators",
            remedy="Design with piezoid.design.observer.disturbance_model.",
        )
    inner = with_oscillators_as_states(observer)
    rest_state = np.linalg.solve(np.eye(len(inner.A)) - inner.A, inner.B)
    gain = float(inner.C @ rest_state)
    sign = float(np.sign(gain))
    return {
        "observer_order": len(inner.A),
        "observer_A": inner.A,
        "observer_B": inner.B,
        "observer_C": sign * inner.C,
        "observer_L": sign * inner.state_gain,
        "observer_disturbance_L_V_per_m": sign * float(inner.disturbance_gain[0]),
        "observer_rest": rest_state,
        "feedback_K_V": inner.feedback_gain,
        "feedback_N_V_per_m": sign * inner.reference_gain,
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

    Raises ``ParameterFileError`` where S has no integrator: the runtime's has.
    """
    remainder = abs(float(S.sum())) / float(np.abs(S).sum())
    if remainder > _INTEGRATOR:
        raise ParameterFileError(
            f"S(1) is {S.sum():.3g}, {remainder:.1e} of its coefficients",
            needed="a controller with an integrator, S(1) = 0",
            remedy="Put 1 - q^-1 among the fixed parts of S.",
        )
    without = np.cumsum(S)[:-1] / S[0]
    return {
        "method": "rst",
        "rst_T_count": len(T),
        "rst_T_V": T / S[0],
        "rst_R_count": len(R),
        "rst_R_V": R / S[0],
        "rst_S_count": len(without),
        "rst_S": without,
        "rst_A0_count": len(antiwindup),
        "rst_A0": antiwindup,
    }
