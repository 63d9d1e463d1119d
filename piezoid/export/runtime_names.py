"""Letters exchanged: a model's operator and a design's loop under the runtime's names.

Design and runtime write the same loop with other letters in two places. The runtime keeps the
constant part of the disturbance by itself and any oscillators among the observer's states; and it
keeps S without its integrator, which is then exact in every precision.
"""

import numpy as np
from numpy.typing import ArrayLike

from piezoid.design.feedforward import ReferencePath, filter_sections
from piezoid.design.observer import DisturbanceObserver
from piezoid.design.observer_loop import with_oscillators_as_states
from piezoid.errors import ParameterFileError
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.runtime.schema import MAX_RELAXATIONS

Given = dict[str, ArrayLike | str]

# |S(1)| up to this part of the sum of magnitudes is an integrator with rounded coefficients.
_INTEGRATOR = 1e-9
_FELT = 1e-6  # a smaller share of creep is none


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


def creep_values(model: AxisModel, sampling_rate_Hz: float) -> Given:
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
        if share > _FELT
    ]
    if not rungs:
        return {}
    kept = sorted(sorted(rungs, reverse=True)[:MAX_RELAXATIONS], key=lambda rung: rung[1])
    share, time_s = np.array(kept).T
    return {
        "relaxation_count": len(kept),
        "relaxation_share": share,
        "relaxation_rate": -np.expm1(-1.0 / (time_s * sampling_rate_Hz)),
    }


def observer_values(observer: DisturbanceObserver) -> Given:
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
    rest = np.linalg.solve(np.eye(len(inner.A)) - inner.A, inner.B)
    gain = float(inner.C @ rest)
    sign = float(np.sign(gain))
    return {
        "observer_order": len(inner.A),
        "observer_A": inner.A,
        "observer_B": inner.B,
        "observer_C": sign * inner.C,
        "observer_L": sign * inner.state_gain,
        "observer_disturbance_L_V_per_m": sign * float(inner.disturbance_gain[0]),
        "observer_rest": rest,
        "feedback_K_V": inner.feedback_gain,
        "feedback_N_V_per_m": sign * inner.reference_gain,
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
