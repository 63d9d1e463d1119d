"""Letters exchanged: a model's operator and a design's loop under the runtime's names.

Design and runtime write the same loop with other letters in two places. The runtime keeps the
constant part of the disturbance by itself and any oscillators among the observer's states; and it
keeps S without its integrator, which is then exact in every precision.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from piezoid.design.feedforward import ReferencePath, filter_sections
from piezoid.design.observer import DisturbanceObserver
from piezoid.errors import ParameterFileError
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array

Given = dict[str, ArrayLike | str]

# |S(1)| up to this part of the sum of magnitudes is an integrator with rounded coefficients.
_INTEGRATOR = 1e-9


def hysteresis_values(model: AxisModel) -> Given:
    """Return the model's operator under the runtime's names, in the de-poled state."""
    operator = model.hysteresis
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
