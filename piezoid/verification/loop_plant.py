"""An AxisPlant as the loop in C takes it: sampled exactly, settled at its rest."""

import ctypes
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from piezoid.design.chain import Section, cascade
from piezoid.errors import ParameterFileError
from piezoid.identification.loop_model import rest_gain
from piezoid.identification.model import Discrepancy
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import LINEAR, DeadZones
from piezoid.operators.linear import ContinuousSystem, first_order, sample
from piezoid.operators.linear import cascade as in_series
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import play_columns
from piezoid.operators.preisach_plays import PreisachPlays, straight_between
from piezoid.verification.loop_library import (
    MAX_STATES,
    RESPOND,
    ArrayOwner,
    Linear,
    LoopPlant,
    Map,
    loop_library,
)
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction

SUBSTEPS = 4  # per sample: amplifier and mechanics are exact, the response is straight in between
_PLAYS, _EXPONENTIAL, _PLUGGED = range(3)
_QUICK = 36.0  # time constants in a substep: what is left of a step is the last bit of a double


@dataclass(frozen=True, kw_only=True, eq=False)
class _Block:
    """A block as the loop takes it, with what its rest needs."""

    linear: Linear
    A: Array
    B: Array
    x: Array

    def settle(self, w: float) -> None:
        """Write the state at rest under a constant input, x = A x + B w."""
        self.x[:] = np.linalg.solve(np.eye(len(self.A)) - self.A, self.B * w)


def rest_position(plant: AxisPlant, initial: LoopPlant | None = None) -> float:
    """Return where the axis stands at rest: m, or A of a junction.

    initial  the plant where it has begun already, with what disturbs it at the first sample
    """
    initial = initial or initial_plant(plant, ArrayOwner(), 0.0)
    return float(initial.w) * (1.0 if plant.measured is None else plant.measured_gain)


def initial_plant(plant: AxisPlant, arrays: ArrayOwner, disturbance: float) -> LoopPlant:
    """Return the plant as the loop takes it, settled at its rest voltage.

    arrays         holds the arrays it points to; it must live as long as the plant
    disturbance  at the first sample
    """
    rate_Hz = plant.sampling_rate_Hz * SUBSTEPS
    response, rest_V = plant.response, plant.rest_voltage_V
    gain = response.gain_nepers_per_V if isinstance(response, Junction) else 1.0
    initial = LoopPlant(substeps=SUBSTEPS)
    initial.reading_zero, initial.reading_lsb = plant.reading_zero, plant.reading_step
    initial.reading_least, initial.reading_most = plant.reading_range
    initial.late = int(plant.delay_s * plant.sampling_rate_Hz)
    initial.late_V = arrays.address(np.full(initial.late, rest_V))
    before, after = (
        _before_hysteresis(plant, rate_Hz, gain, arrays),
        _after_hysteresis(plant, rate_Hz, arrays),
    )
    initial.before, initial.after = before.linear, after.linear
    if isinstance(response, Junction):
        initial.kind, initial.current_A = _EXPONENTIAL, response.current_A
        initial.current_most = response.most_A or 0.0
        disturbance += gain * rest_V
    elif isinstance(response, Hysteresis):
        initial.kind = _PLAYS
        _fill_hysteresis(initial, response, arrays, plant)
    else:
        initial.kind, initial.respond = _PLUGGED, RESPOND(response.begin(rest_V))
        arrays.arrays.append(initial.respond)
    initial.slew_step = (plant.slew_V_per_s or 0.0) * gain / rate_Hz
    initial.driven = gain * rest_V
    address = ctypes.addressof(initial)
    initial.w = loop_library().pl_response(address, gain * rest_V, disturbance)
    before.settle(rest_V)
    after.settle(initial.w)
    return initial


def _fill_hysteresis(
    initial: LoopPlant, response: Hysteresis, arrays: ArrayOwner, plant: AxisPlant
) -> None:
    operator = response.operator
    initial.polarity = response.polarity
    initial.voltage_offset_V = operator.voltage_offset_V
    initial.displacement_offset_m = operator.displacement_offset_m / plant.measured_gain
    initial.low_V, initial.high_V = response.low_V, response.high_V
    past_V = np.array([*response.history_V, plant.rest_voltage_V])
    past_V = np.clip(past_V, response.low_V, response.high_V)
    _, states_V = operator.run(past_V, operator.virgin_memory())
    initial.play_V = arrays.address(np.array(states_V))
    if isinstance(operator, PreisachPlays):
        irreversible_m = _fill_functions(initial, operator, states_V, arrays)
    else:
        irreversible_m = _fill_plays(initial, operator, states_V, arrays)
    if response.activation_s > 0.0:
        initial.irreversible_m = irreversible_m
        instants_per_s = plant.sampling_rate_Hz * SUBSTEPS
        initial.activation_step = float(np.exp(-1.0 / (response.activation_s * instants_per_s)))
        initial.activation_m = response.activation_m
    if response.discrepancy is not None:
        _fill_discrepancy(initial, response.discrepancy, past_V, arrays)
    if plant.cyclic is not None:
        initial.cyclic_orders = len(plant.cyclic.cosine_m)
        initial.cyclic_per_m = 2.0 * np.pi / plant.cyclic.wavelength_m
        initial.cyclic_cosine_m = arrays.address(np.array(plant.cyclic.cosine_m))
        initial.cyclic_sine_m = arrays.address(np.array(plant.cyclic.sine_m))


def _fill_plays(
    initial: LoopPlant, operator: ModifiedPrandtlIshlinskii, states_V: Array, arrays: ArrayOwner
) -> float:
    """Return where the irreversible part is, m."""
    initial.plays = len(operator.plays.threshold)
    initial.threshold_V = arrays.address(operator.plays.threshold)
    initial.weight = arrays.address(operator.plays.weight)
    initial.envelope, initial.zones = (
        _map(part, arrays) for part in (operator.envelope, operator.dead_zones)
    )
    return float(operator.plays.weight[1:] @ states_V[1:])


def _fill_functions(
    initial: LoopPlant, operator: PreisachPlays, states_V: Array, arrays: ArrayOwner
) -> float:
    """Return where the irreversible part is, m."""
    initial.plays, initial.edges = operator.value_m.shape
    initial.threshold_V = arrays.address(operator.threshold_V)
    initial.edge_V = arrays.address(operator.edge_V)
    initial.value_m = arrays.address(np.ascontiguousarray(operator.value_m))
    initial.envelope, initial.zones = _map(LINEAR, arrays), _map(LINEAR, arrays)
    return sum(
        float(straight_between(state_V, operator.edge_V, value_m)[0])
        for state_V, value_m in zip(states_V[1:, None], operator.value_m[1:], strict=True)
    )


def _fill_discrepancy(
    initial: LoopPlant, second: Discrepancy, past_V: Array, arrays: ArrayOwner
) -> None:
    initial.second_powers, initial.second_plays = second.weight_m.shape
    initial.second_threshold_V = arrays.address(second.threshold_V)
    initial.second_weight_m = arrays.address(np.ascontiguousarray(second.weight_m))
    away_V = past_V - second.centre_V
    _, states_V = play_columns(away_V, second.threshold_V, np.zeros(len(second.threshold_V)))
    initial.second_play_V = arrays.address(np.array(states_V))
    initial.second_centre_V, initial.second_reach_V = second.centre_V, second.reach_V


def _map(zones: DeadZones, arrays: ArrayOwner) -> Map:
    slope = np.ascontiguousarray(zones.slope)
    return Map(
        knots=len(zones.threshold),
        knot=arrays.address(zones.threshold),
        slope=arrays.address(slope),
        zero=zones.zero,
    )


def _before_hysteresis(
    plant: AxisPlant, rate_Hz: float, gain: float, arrays: ArrayOwner
) -> _Block:
    """Return amplifier and what the delay has beside whole samples, behind a held command."""
    whole_s = int(plant.delay_s * plant.sampling_rate_Hz) / plant.sampling_rate_Hz
    sections = plant.amplifier or (Section(frequency_Hz=_QUICK * rate_Hz / (2.0 * np.pi)),)
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
    return _block(sampled.A, (sampled.B[:, 0], np.zeros(len(sampled.A))), rows, (0.0, 0.0), arrays)


def _after_hysteresis(plant: AxisPlant, rate_Hz: float, arrays: ArrayOwner) -> _Block:
    """Return mechanics and sensor behind a signal that is straight between substeps.

    x[k+1] = e^(A h) x[k] + G_1 w[k] + G_2 (w[k+1] - w[k])
    """
    A, B, C, D = _behind(plant)
    states = len(A)
    line = np.zeros((states + 2, states + 2))
    line[:states, :states], line[:states, states] = A / rate_Hz, B / rate_Hz
    line[states, states + 1] = 1.0
    transition = expm(line)[:states]
    constant, ramp = transition[:, states], transition[:, states + 1]
    return _block(transition[:, :states], (constant - ramp, ramp), C, D, arrays)


def _behind(plant: AxisPlant) -> tuple[Array, Array, Array, tuple[float, float]]:
    """Return what stands behind the response: A, B, and the rows of position and sensed."""
    if plant.measured is not None:
        scale = plant.measured_gain / rest_gain(plant.measured)
        sensor = [first_order(section.frequency_Hz) for section in plant.sensor]
        chain = in_series(plant.measured, *sensor)
        inner = len(chain.A) - len(plant.measured.A)
        row = np.concatenate([plant.measured.C[0], np.zeros(inner)])
        direct = (scale * float(plant.measured.D[0, 0]), scale * float(chain.D[0, 0]))
        return chain.A, chain.B[:, 0], scale * np.stack([row, chain.C[0]]), direct
    A, B, outputs = cascade((*plant.mechanics, *plant.sensor))
    C, D = np.zeros((2, len(A))), [0.0, 0.0]
    for row_of, sections in enumerate((len(plant.mechanics), len(outputs))):
        if sections:
            C[row_of, outputs[sections - 1]] = 1.0
        else:
            D[row_of] = 1.0
    return A, B, C, (D[0], D[1])


def _block(
    A: Array, drive: tuple[Array, Array], C: Array, D: tuple[float, float], arrays: ArrayOwner
) -> _Block:
    """Build a block; ``drive`` holds B_old and B_new."""
    old, new = drive
    if len(A) > MAX_STATES:
        raise ParameterFileError(
            f"the plant has {len(A)} states in one block",
            needed=f"at most {MAX_STATES}, what the loop has room for",
            remedy="Fit a model with fewer modes, or give the controller a higher rate.",
        )
    x = np.zeros(len(A))
    linear = Linear(states=len(A), x=arrays.address(x))
    for name, array in {"A": A, "B_old": old, "B_new": new, "C": C}.items():
        setattr(linear, name, arrays.address(np.ascontiguousarray(array, dtype=np.float64)))
    linear.D[:] = D
    return _Block(linear=linear, A=A, B=old + new, x=x)
