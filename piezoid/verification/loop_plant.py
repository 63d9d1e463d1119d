"""Convert an AxisPlant to the structures of plant_loop.c, sampled exactly and settled at rest."""

import ctypes
from functools import cache
from typing import Any

import numpy as np
from scipy.linalg import expm

from piezoid.design.plant import Section, cascade
from piezoid.errors import ParameterFileError
from piezoid.identification.loop_model import rest_gain
from piezoid.numerics.arrays import Array
from piezoid.numerics.compiled import opened
from piezoid.operators.dead_zone import LINEAR
from piezoid.operators.linear import ContinuousSystem, first_order, sample
from piezoid.operators.linear import cascade as in_series
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_plays import PreisachPlays, straight_between
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction

SUBSTEPS = 4  # per sample; amplifier and mechanics are exact, the response linear in a substep
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


class Map(ctypes.Structure):
    """``pl_map``."""

    _fields_ = (*_fields(_SIZE, "knots"), *_fields(_POINTER, "knot slope"), ("zero", _SIZE))


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
        *_fields(Map, "envelope zones"),
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
    """

    def __init__(self, plant: AxisPlant, disturbance: Array | None = None) -> None:
        """Sample and settle a plant under the first sample of its disturbance."""
        rate_Hz = plant.sampling_rate_Hz * SUBSTEPS
        response, rest_V = plant.response, plant.rest_voltage_V
        begin = 0.0 if disturbance is None else float(disturbance[0])
        gain = response.gain_nepers_per_V if isinstance(response, Junction) else 1.0
        self.plant, self._arrays = plant, list[Any]()
        self.structure = c = LoopPlant(substeps=SUBSTEPS)
        c.reading_zero, c.reading_lsb = plant.reading_zero, plant.reading_step
        c.reading_least, c.reading_most = plant.reading_range
        c.late = int(plant.delay_s * plant.sampling_rate_Hz)
        c.late_V = self.address(np.full(c.late, rest_V))
        if isinstance(response, Junction):
            c.kind, c.current_A = _EXPONENTIAL, response.current_A
            c.current_most = response.saturation_A or 0.0
            begin += gain * rest_V
        elif isinstance(response, Hysteresis):
            c.kind = _PLAYS
            self._fill_hysteresis(response)
        else:
            c.kind, c.respond = _PLUGGED, _RESPOND(response.begin(rest_V))
            self._arrays.append(c.respond)
        if plant.cyclic is not None:
            c.cyclic_orders = len(plant.cyclic.cosine_m)
            c.cyclic_per_m = 2.0 * np.pi / plant.cyclic.wavelength_m
            c.cyclic_cosine_m = self.address(np.array(plant.cyclic.cosine_m))
            c.cyclic_sine_m = self.address(np.array(plant.cyclic.sine_m))
        c.slew_step = (plant.slew_V_per_s or 0.0) * gain / rate_Hz
        c.driven = gain * rest_V
        c.w = loop_library().pl_response(ctypes.addressof(c), gain * rest_V, begin)
        c.before = self._settled(*_before_hysteresis(plant, rate_Hz, gain), rest_V)
        c.after = self._settled(*_after_hysteresis(plant, rate_Hz), c.w)

    @property
    def rest_position(self) -> float:
        """Position at rest: m, or A of a junction."""
        gain = 1.0 if self.plant.measured is None else self.plant.measured_gain
        return float(self.structure.w) * gain

    def address(self, array: Array) -> int:
        """Return the address of an array, and keep a reference to the array."""
        self._arrays.append(array)
        return int(array.ctypes.data)

    def _fill_hysteresis(self, response: Hysteresis) -> None:
        c, plant, operator = self.structure, self.plant, response.operator
        c.polarity = response.polarity
        c.voltage_offset_V = operator.voltage_offset_V
        c.displacement_offset_m = operator.displacement_offset_m / plant.measured_gain
        c.low_V, c.high_V = response.low_V, response.high_V
        past_V = np.array([*response.history_V, plant.rest_voltage_V])
        past_V = np.clip(past_V, response.low_V, response.high_V)
        _, states_V = operator.run(past_V, operator.virgin_memory())
        c.play_V = self.address(np.array(states_V))
        envelope = zones = LINEAR
        if isinstance(operator, PreisachPlays):
            c.plays, c.edges = operator.value_m.shape
            c.threshold_V = self.address(operator.threshold_V)
            c.edge_V = self.address(operator.edge_V)
            c.value_m = self.address(np.ascontiguousarray(operator.value_m))
            irreversible_m = sum(
                float(straight_between(state_V, operator.edge_V, value_m)[0])
                for state_V, value_m in zip(states_V[1:, None], operator.value_m[1:], strict=True)
            )
        else:
            c.plays = len(operator.plays.threshold)
            c.threshold_V = self.address(operator.plays.threshold)
            c.weight = self.address(operator.plays.weight)
            envelope, zones = operator.envelope, operator.dead_zones
            irreversible_m = float(operator.plays.weight[1:] @ states_V[1:])
        for name, curve in (("envelope", envelope), ("zones", zones)):
            slope = self.address(np.ascontiguousarray(curve.slope))
            knot = self.address(curve.threshold)
            knots = len(curve.threshold)
            setattr(c, name, Map(knots=knots, knot=knot, slope=slope, zero=curve.zero))
        if response.activation_s > 0.0:
            substeps_per_s = plant.sampling_rate_Hz * SUBSTEPS
            c.irreversible_m = irreversible_m
            c.activation_step = float(np.exp(-1.0 / (response.activation_s * substeps_per_s)))
            c.activation_m = response.activation_m
        discrepancy = response.discrepancy
        if discrepancy is not None:
            centre_V, threshold_V = discrepancy.centre_V, discrepancy.threshold_V
            c.second_powers, c.second_plays = discrepancy.weight_m.shape
            c.second_threshold_V = self.address(threshold_V)
            c.second_weight_m = self.address(np.ascontiguousarray(discrepancy.weight_m))
            virgin_V = np.zeros(len(threshold_V))
            _, states_V = play_columns(past_V - centre_V, threshold_V, virgin_V)
            c.second_play_V = self.address(np.array(states_V))
            c.second_centre_V, c.second_reach_V = centre_V, discrepancy.reach_V

    def _settled(
        self, A: Array, previous: Array, present: Array, C: Array, D: tuple[float, float], w: float
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
        for name, array in {"A": A, "B_old": previous, "B_new": present, "C": C, "x": x}.items():
            setattr(block, name, self.address(np.ascontiguousarray(array, dtype=np.float64)))
        return block


_Sampled = tuple[Array, Array, Array, Array, tuple[float, float]]
"""A, B_old, B_new, C and D of ``pl_linear``."""


def _before_hysteresis(plant: AxisPlant, rate_Hz: float, gain: float) -> _Sampled:
    """Return amplifier and fractional delay, for a held command."""
    whole_s = int(plant.delay_s * plant.sampling_rate_Hz) / plant.sampling_rate_Hz
    instantaneous_Hz = _INSTANTANEOUS * rate_Hz / (2.0 * np.pi)
    sections = plant.amplifier or (Section(frequency_Hz=instantaneous_Hz),)
    A, B, outputs = cascade(sections)
    system = ContinuousSystem(
        A=A,
        B=B[:, None],
        C=np.eye(len(A))[outputs[-1]][None, :],
        D=np.zeros((1, 1)),
        delay_s=max(plant.delay_s - whole_s, 0.0),
    )
    sampled = sample(in_series(system, *plant.drive_modes), rate_Hz)
    rows = np.vstack([gain * sampled.C, np.zeros_like(sampled.C)])
    return sampled.A, sampled.B[:, 0], np.zeros(len(sampled.A)), rows, (0.0, 0.0)


def _after_hysteresis(plant: AxisPlant, rate_Hz: float) -> _Sampled:
    """Return mechanics and sensor, for an input that is linear between substeps.

    x[k+1] = e^(A h) x[k] + G_1 w[k] + G_2 (w[k+1] - w[k])
    """
    # The rows of C and D are the position and the sensed position.
    if plant.measured is not None:
        scale = plant.measured_gain / rest_gain(plant.measured)
        sensor = [first_order(section.frequency_Hz) for section in plant.sensor]
        chain = in_series(plant.measured, *sensor)
        inner = len(chain.A) - len(plant.measured.A)
        row = np.concatenate([plant.measured.C[0], np.zeros(inner)])
        A, B, C = chain.A, chain.B[:, 0], scale * np.stack([row, chain.C[0]])
        D = [scale * float(plant.measured.D[0, 0]), scale * float(chain.D[0, 0])]
    else:
        A, B, outputs = cascade((*plant.mechanics, *plant.sensor))
        C, D = np.zeros((2, len(A))), [0.0, 0.0]
        for index, sections in enumerate((len(plant.mechanics), len(outputs))):
            if sections:
                C[index, outputs[sections - 1]] = 1.0
            else:
                D[index] = 1.0
    states = len(A)
    line = np.zeros((states + 2, states + 2))
    line[:states, :states], line[:states, states] = A / rate_Hz, B / rate_Hz
    line[states, states + 1] = 1.0
    transition = expm(line)[:states]
    constant, ramp = transition[:, states], transition[:, states + 1]
    return transition[:, :states], constant - ramp, ramp, C, (D[0], D[1])
