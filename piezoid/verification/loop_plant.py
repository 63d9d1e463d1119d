"""Convert an AxisPlant to the structures of plant_loop.c, sampled exactly and settled at rest."""

import ctypes
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from piezoid.errors import ParameterFileError
from piezoid.identification.loop_model import rest_gain, through
from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import opened
from piezoid.operators.dead_zone import LINEAR, KernelMap
from piezoid.operators.linear import cascade, first_order, sample
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_plays import PreisachPlays, straight_between
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction

SUBSTEPS = 4  # per sample; systems are exact, the response linear in a substep
_PLAYS, _EXPONENTIAL, _PLUGGED = range(3)
# Time constants in a substep, after which a step response has settled to the last bit of a double.
_INSTANTANEOUS = 36.0
_MAX_STATES = 64

_RESPOND = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)


def _fields(kind: Any, names: str) -> tuple[tuple[str, Any], ...]:
    """Return members of one type, their names separated by spaces."""
    return tuple((name, kind) for name in names.split())


_SIZE, _POINTER, _REAL = ctypes.c_size_t, ctypes.c_void_p, ctypes.c_double


class Linear(ctypes.Structure):
    """``pl_linear``."""

    _fields_ = (
        *_fields(_SIZE, "states"),
        *_fields(_POINTER, "A B_old B_new C"),
        ("D", _REAL * 2),
        *_fields(_POINTER, "x"),
    )


class LoopPlant(ctypes.Structure):
    """``pl_plant``."""

    _fields_ = (
        *_fields(_SIZE, "substeps late waited"),
        *_fields(_POINTER, "late_V"),
        *_fields(Linear, "before after"),
        *_fields(ctypes.c_int64, "kind"),
        *_fields(_SIZE, "plays"),
        *_fields(_POINTER, "threshold_V weight play_V"),
        *_fields(_SIZE, "edges"),
        *_fields(_POINTER, "edge_V value_m"),
        *_fields(KernelMap, "envelope zones"),  # pl_map is the same structure
        *_fields(_REAL, "low_V high_V activation_step activation_m irreversible_m"),
        *_fields(_SIZE, "second_plays second_powers"),
        *_fields(_POINTER, "second_threshold_V second_weight_m second_play_V"),
        *_fields(_REAL, "second_centre_V second_reach_V"),
        *_fields(_SIZE, "cyclic_orders"),
        *_fields(_POINTER, "cyclic_cosine_m cyclic_sine_m"),
        *_fields(_REAL, "cyclic_per_m"),
        *_fields(_REAL, "polarity voltage_offset_V displacement_offset_m current_A current_most"),
        ("respond", _RESPOND),
        *_fields(_REAL, "slew_step driven w"),
        *_fields(_REAL, "reading_zero reading_lsb reading_least reading_most"),
    )


class LoopRun(ctypes.Structure):
    """``pl_run``."""

    _fields_ = (
        *_fields(_POINTER, "step_double step_float state parameters"),
        *_fields(_SIZE, "samples"),
        *_fields(_POINTER, "reference disturbance noise fault reset"),
        *_fields(_SIZE, "reset_at"),
        *_fields(_POINTER, "driven position measured voltage_V status"),
    )


@cache
def loop_library() -> ctypes.CDLL:
    """Open the compiled plant loop."""
    functions = {
        "pl_response": (_REAL, (_POINTER, _REAL, _REAL)),
        "pl_loop": (None, (_POINTER, _POINTER)),
    }
    return opened("piezoid.verification._plant_loop", functions)


class SettledPlant:
    """A plant as ``pl_plant``, settled at its rest voltage, and the arrays that it references.

    structure  of the C loop; it must not outlive this object
    arrays     that the structure references, by the names of its members
    """

    def __init__(self, plant: AxisPlant, disturbance: Array | None = None) -> None:
        """Sample and settle a plant under the first sample of its disturbance."""
        rate_Hz = plant.sampling_rate_Hz * SUBSTEPS
        response, rest_V = plant.response, plant.rest_voltage_V
        begin = 0.0 if disturbance is None else float(disturbance[0])
        gain = response.gain_nepers_per_V if isinstance(response, Junction) else 1.0
        self.plant, self.arrays = plant, dict[str, Array]()
        self.structure = c = LoopPlant(substeps=SUBSTEPS)
        c.reading_zero, c.reading_lsb = plant.reading_zero, plant.reading_step
        c.reading_least, c.reading_most = plant.reading_range
        c.late = int(plant.delay_s * plant.sampling_rate_Hz)
        self.point(c, late_V=np.full(c.late, rest_V))
        if isinstance(response, Junction):
            c.kind, c.current_A = _EXPONENTIAL, response.current_A
            c.current_most = response.saturation_A or 0.0
            begin += gain * rest_V
        elif isinstance(response, Hysteresis):
            c.kind = _PLAYS
            self._fill_hysteresis(response)
        else:
            c.kind, c.respond = _PLUGGED, _RESPOND(response.begin(rest_V))
        if plant.cyclic is not None:
            c.cyclic_orders = len(plant.cyclic.cosine_m)
            c.cyclic_per_m = 2.0 * np.pi / plant.cyclic.wavelength_m
            cosine_m, sine_m = np.array(plant.cyclic.cosine_m), np.array(plant.cyclic.sine_m)
            self.point(c, cyclic_cosine_m=cosine_m, cyclic_sine_m=sine_m)
        c.slew_step = (plant.slew_V_per_s or 0.0) * gain / rate_Hz
        c.driven = gain * rest_V
        c.w = loop_library().pl_response(ctypes.addressof(c), gain * rest_V, begin)
        c.before = self._settled("before_", *_before_hysteresis(plant, rate_Hz, gain), rest_V)
        c.after = self._settled("after_", *_after_hysteresis(plant, rate_Hz), c.w)

    @property
    def rest_position(self) -> float:
        """Position at rest: m, or A of a junction."""
        gain = 1.0 if self.plant.measured is None else self.plant.measured_gain
        return float(self.structure.w) * gain

    def point(self, structure: ctypes.Structure, prefix: str = "", /, **arrays: Array) -> None:
        """Set pointers of a structure to arrays, and keep the arrays under a prefix and a name."""
        for name, values in arrays.items():
            self.arrays[prefix + name] = array = np.ascontiguousarray(values, dtype=np.float64)
            setattr(structure, name, array.ctypes.data)

    def _fill_hysteresis(self, response: Hysteresis) -> None:
        c, plant, operator = self.structure, self.plant, response.operator
        c.polarity = response.polarity
        c.voltage_offset_V = operator.voltage_offset_V
        c.displacement_offset_m = operator.displacement_offset_m / plant.measured_gain
        c.low_V, c.high_V = response.low_V, response.high_V
        past_V = np.array([*response.history_V, plant.rest_voltage_V])
        past_V = np.clip(past_V, response.low_V, response.high_V)
        _, states_V = operator.run(past_V, operator.virgin_memory())
        self.point(c, play_V=np.array(states_V))
        envelope = zones = LINEAR
        if isinstance(operator, PreisachPlays):
            c.plays, c.edges = operator.value_m.shape
            self.point(c, threshold_V=operator.threshold_V, edge_V=operator.edge_V)
            self.point(c, value_m=operator.value_m)
            irreversible_m = sum(
                float(straight_between(state_V, operator.edge_V, value_m)[0])
                for state_V, value_m in zip(states_V[1:, None], operator.value_m[1:], strict=True)
            )
        else:
            c.plays = len(operator.plays.threshold)
            self.point(c, threshold_V=operator.plays.threshold, weight=operator.plays.weight)
            envelope, zones = operator.envelope, operator.dead_zones
            irreversible_m = float(operator.plays.weight[1:] @ states_V[1:])
        for name, curve in (("envelope", envelope), ("zones", zones)):
            setattr(c, name, curve.kernel_map())
            self.arrays |= {f"{name}_knot": curve.threshold, f"{name}_slope": curve.slope}
        if response.activation_s > 0.0:
            substeps_per_s = plant.sampling_rate_Hz * SUBSTEPS
            c.irreversible_m = irreversible_m
            c.activation_step = float(np.exp(-1.0 / (response.activation_s * substeps_per_s)))
            c.activation_m = response.activation_m
        discrepancy = response.discrepancy
        if discrepancy is not None:
            centre_V, threshold_V = discrepancy.centre_V, discrepancy.threshold_V
            c.second_powers, c.second_plays = discrepancy.weight_m.shape
            virgin_V = np.zeros(len(threshold_V))
            _, states_V = play_columns(past_V - centre_V, threshold_V, virgin_V)
            self.point(c, second_threshold_V=threshold_V, second_play_V=np.array(states_V))
            self.point(c, second_weight_m=discrepancy.weight_m)
            c.second_centre_V, c.second_reach_V = centre_V, discrepancy.reach_V

    def _settled(
        self,
        prefix: str,
        A: Array,
        previous: Array,
        present: Array,
        C: Array,
        D: tuple[float, float],
        w: float,
    ) -> Linear:
        """Return a block at rest under a constant input, x = A x + (previous + present) w."""
        if len(A) > _MAX_STATES:
            raise ParameterFileError(
                f"the plant has {len(A)} states in one block",
                needed=f"at most {_MAX_STATES}",
                remedy="Fit a model with fewer modes, or give the controller a higher rate.",
            )
        x = np.array(np.linalg.solve(np.eye(len(A)) - A, (previous + present) * w))
        block = Linear(states=len(A), D=D)
        self.point(block, prefix, A=A, B_old=previous, B_new=present, C=C, x=x)
        return block


_Sampled = tuple[Array, Array, Array, Array, tuple[float, float]]
"""A, B_old, B_new, C and D of ``pl_linear``."""


def _before_hysteresis(plant: AxisPlant, rate_Hz: float, gain: float) -> _Sampled:
    """Return amplifier, modes of the drive and fractional delay, for a held command."""
    whole_s = int(plant.delay_s * plant.sampling_rate_Hz) / plant.sampling_rate_Hz
    front = plant.front or (first_order(_INSTANTANEOUS * rate_Hz / (2.0 * np.pi)),)
    system = replace(cascade(*front), delay_s=max(plant.delay_s - whole_s, 0.0))
    sampled = sample(system, rate_Hz)
    rows = np.vstack([gain * sampled.C, np.zeros_like(sampled.C)])
    return sampled.A, sampled.B[:, 0], np.zeros(len(sampled.A)), rows, (0.0, 0.0)


def _after_hysteresis(plant: AxisPlant, rate_Hz: float) -> _Sampled:
    """Return measured dynamics and sensor, for an input that is linear between substeps.

    x[k+1] = e^(A h) x[k] + G_1 w[k] + G_2 (w[k+1] - w[k])
    """
    inner, scale = through(), 1.0
    if plant.measured is not None:
        inner, scale = plant.measured, plant.measured_gain / rest_gain(plant.measured)
    chain = cascade(inner, *plant.sensor)
    states = len(chain.A)
    # The rows of C and D are the position and the sensed position.
    position = np.concatenate([inner.C[0], np.zeros(states - len(inner.A))])
    C = scale * np.stack([position, chain.C[0]])
    D = (scale * float(inner.D[0, 0]), scale * float(chain.D[0, 0]))
    line = np.zeros((states + 2, states + 2))
    line[:states, :states], line[:states, states] = chain.A / rate_Hz, chain.B[:, 0] / rate_Hz
    line[states, states + 1] = 1.0
    transition = expm(line)[:states]
    constant, ramp = transition[:, states], transition[:, states + 1]
    return transition[:, :states], constant - ramp, ramp, C, D
