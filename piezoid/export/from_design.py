"""From a model and a design to what the runtime consumes: names exchanged, nothing decided.

Design and runtime write the same loop with other letters in two places. The runtime keeps the
constant part of the disturbance by itself and any oscillators among the observer's states; and it
keeps S without its integrator, which is then exact in every precision.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from piezoid.design.design import AxisDesign, LoopDesign
from piezoid.design.feedforward import ReferencePath, filter_sections
from piezoid.design.observer import DisturbanceObserver
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.runtime.values import complete

Given = dict[str, ArrayLike | str]

# A measurement this much beyond the reachable range, as a part of it, is not believed.
_DISBELIEF = 0.25
# |S(1)| up to this part of the sum of magnitudes is an integrator with rounded coefficients.
_INTEGRATOR = 1e-9


@dataclass(frozen=True, kw_only=True)
class TunnellingGuards:
    """What keeps a tip from the surface whatever the controller wants.

    reference_A        the logarithm is 0 here: the usual setpoint
    floor_A            smaller currents count as this, which bounds the speed of an approach
    ceiling_A          from here on the tip is retracted at once
    retract_voltage_V  where to
    retract_samples    and for how long
    bad_samples        unusable currents in a row that retract as well
    """

    reference_A: float
    floor_A: float
    ceiling_A: float
    retract_voltage_V: float
    retract_samples: int
    bad_samples: int

    @property
    def values(self) -> Given:
        """The same under the runtime's names."""
        return {
            "current_reference_A": self.reference_A,
            "current_floor_A": self.floor_A,
            "current_ceiling_A": self.ceiling_A,
            "retract_voltage_V": self.retract_voltage_V,
            "retract_samples": self.retract_samples,
            "bad_samples": self.bad_samples,
        }


def lateral_axis(
    model: AxisModel, design: AxisDesign, further: Mapping[str, ArrayLike | str] | None = None
) -> AxisParameters:
    """Return X or Y with its recommended loop, and every other method to compare it with.

    further  runtime parameters the design does not speak of: ``stuck_samples``, creep, ...

    Feedforward alone (``none``, ``mpi``) takes the references as they are: filter and preview
    belong to the loop they were fitted for.
    """
    common = {
        **_limits(design),
        **_range(model, design),
        **hysteresis_values(model),
        **(further or {}),
    }
    _same_direction(model, design)
    loops = {loop.method: complete({**common, **_loop_values(loop)}) for loop in design.loops}
    gain = {"gain_m_per_V": loops[design.recommended.method]["gain_m_per_V"]}
    for method in ("mpi", "none"):
        loops[method] = complete({**common, **gain, "method": method})
    return AxisParameters(
        axis=design.axis,
        values=loops[design.recommended.method],
        alternatives=tuple(v for m, v in loops.items() if m != design.recommended.method),
    )


def tunnelling_axis(
    design: AxisDesign,
    guards: TunnellingGuards,
    further: Mapping[str, ArrayLike | str] | None = None,
) -> AxisParameters:
    """Return Z with its recommended loop behind its guards.

    further  runtime parameters the design does not speak of: ``voltage_step_V``, ...
    """
    loop = design.recommended
    return AxisParameters(
        axis=design.axis,
        values=complete(
            {
                **_limits(design),
                **guards.values,
                **rst_values(loop.R, loop.S, loop.T, loop.A_0),
                **reference_values(loop.reference),
                **(further or {}),
            }
        ),
    )


def hysteresis_values(model: AxisModel) -> Given:
    """Return the model's operator under the runtime's names, in the de-poled state."""
    operator: ModifiedPrandtlIshlinskii = model.hysteresis
    given: Given = {
        "polarity": model.polarity,
        "voltage_offset_V": operator.voltage_offset_V,
        "displacement_offset_m": operator.displacement_offset_m,
        "play_count": len(operator.plays.threshold),
        "play_threshold_V": operator.plays.threshold,
        "play_weight_m_per_V": operator.plays.weight,
        "play_memory_V": operator.virgin_memory(),
    }
    for name, unit, zones in (
        ("knot", "m", operator.dead_zones),
        ("envelope", "V", operator.envelope),
    ):
        stem = "knot" if name == "knot" else "envelope_knot"
        given |= {
            f"{name}_count": len(zones.threshold),
            f"{stem}_{unit}": zones.threshold,
            f"{name}_weight": zones.weight,
        }
    return given


def observer_values(observer: DisturbanceObserver) -> Given:
    """Return the observer's gains under the runtime's names.

        x_e = [x; w_osc],  A_e = [A  B c_osc; 0  F_osc],  B_e = [B; 0],  K_e = [K  c_osc]

    with w_osc the disturbance states behind the first, which is the constant the runtime carries.
    A plant that falls as the drive rises is mirrored, as the runtime mirrors its displacement.
    """
    turn, c = observer.disturbance.transition, observer.disturbance.output
    if turn[0, 0] != 1.0 or c[0] != 1.0 or turn[0, 1:].any() or turn[1:, 0].any():
        raise ParameterFileError(
            "the observer's first disturbance state is no constant",
            needed="a constant first, then oscillators",
            remedy="Design with piezoid.design.observer.disturbance_model.",
        )
    oscillators = len(c) - 1
    rest = np.linalg.solve(np.eye(len(observer.A)) - observer.A, observer.B)
    gain = float(observer.C @ rest)
    sign = float(np.sign(gain))
    A = block_diag(observer.A, turn[1:, 1:])
    A[: len(rest), len(rest) :] = np.outer(observer.B, c[1:])
    zeros = np.zeros(oscillators)
    correction = np.r_[observer.state_gain, observer.disturbance_gain[1:]]
    return {
        "observer_order": len(A),
        "observer_A": A,
        "observer_B": np.r_[observer.B, zeros],
        "observer_C": sign * np.r_[observer.C, zeros],
        "observer_L": sign * correction,
        "observer_disturbance_L_V_per_m": sign * float(observer.disturbance_gain[0]),
        "observer_rest": np.r_[rest, zeros],
        "feedback_K_V": np.r_[observer.feedback_gain, c[1:]],
        "feedback_N_V_per_m": sign * observer.reference_gain,
        "gain_m_per_V": sign * gain,
    }


def reference_values(path: ReferencePath) -> Given:
    """Return filter and preview under the runtime's names."""
    sections = filter_sections(path.filter)
    return {
        "reference_section_count": len(sections),
        "reference_section": sections,
        "preview_samples": path.preview_samples,
    }


def rst_values(R: Array, S: Array, T: Array, antiwindup: Array) -> Given:
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


def _loop_values(loop: LoopDesign) -> Given:
    if loop.observer is None:
        raise ParameterFileError(
            f"the loop of method {loop.method} has no observer",
            needed="a disturbance observer for X and Y",
            remedy="Use tunnelling_axis for a controller given as R, S and T.",
        )
    return {
        "method": loop.method,
        **observer_values(loop.observer),
        **reference_values(loop.reference),
    }


def _same_direction(model: AxisModel, design: AxisDesign) -> None:
    plant = design.recommended.members[0]
    gain = float(plant.B.sum() / plant.A.sum())
    if gain * model.polarity <= 0:
        raise ParameterFileError(
            f"axis {design.axis}: the design's plant moves {gain:.3g} m/V, the model's polarity "
            f"is {model.polarity}",
            needed="a design for the direction in which the stage moves",
            remedy="Design again from this model.",
        )


def _limits(design: AxisDesign) -> Given:
    asked = design.specification
    return {
        "sampling_rate_Hz": design.recommended.members[0].sampling_rate_Hz,
        "voltage_minimum_V": asked.voltage_min_V,
        "voltage_maximum_V": asked.voltage_max_V,
        "lsb_V": asked.voltage_step_V,
    }


def _range(model: AxisModel, design: AxisDesign) -> Given:
    """Return what the model reaches between the voltage limits, and what to believe."""
    asked, operator = design.specification, model.hysteresis
    ends = np.array([asked.voltage_min_V, asked.voltage_max_V, asked.voltage_min_V])
    moved, _ = operator.run(ends, operator.virgin_memory())
    offset = operator.displacement_offset_m
    reached = offset + model.polarity * (moved - offset)
    low, high = float(reached.min()), float(reached.max())
    margin = _DISBELIEF * (high - low)
    return {
        "reference_minimum_m": low,
        "reference_maximum_m": high,
        "displacement_minimum_m": low - margin,
        "displacement_maximum_m": high + margin,
    }
