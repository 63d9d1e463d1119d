"""Plant and compiled runtime together, sample by sample, from a parameter file's numbers."""

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from piezoid.design.chain import Section
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters
from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import DeadZones
from piezoid.operators.linear import ContinuousSystem, sample
from piezoid.runtime.controller import Controller
from piezoid.verification.loop_library import (
    MAX_STATES,
    RESPOND,
    Kept,
    Linear,
    LoopPlant,
    LoopRun,
    Map,
    loop_library,
)
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction

SUBSTEPS = 4  # per sample: amplifier and mechanics are exact, the response is straight in between
_PLAYS, _EXPONENTIAL, _PLUGGED = range(3)
_QUICK = 36.0  # time constants in a substep: what is left of a step is the last bit of a double


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRecord:
    """What happened on one axis.

    reference  (samples,)  m (junction: A), as wanted at that instant
    position   (samples,)  m (junction: A), in front of the sensor
    measured   (samples,)  what the controller read
    voltage_V  (samples,)  what it put out then
    status     (samples,)  the runtime's bits
    """

    axis: str
    sampling_rate_Hz: float
    reference: Array
    position: Array
    measured: Array
    voltage_V: Array
    status: NDArray[np.uint32]


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


def run_axis(
    plant: AxisPlant,
    parameters: AxisParameters,
    reference: Array,
    *,
    rng: np.random.Generator,
    disturbance: Array | None = None,
    fault: Array | None = None,
    precision: str = "double",
) -> LoopRecord:
    """Run one axis from rest, with the values that ship.

    reference    (samples,)  m (junction: A); given to the runtime as much ahead as it previews
    disturbance  (samples,)  m at the response's output (junction: nepers, taken from ln i)
    fault        (samples,)  0: none; 1: the reading stays as it was; NaN: it is NaN
    precision    of the runtime, ``double`` or ``float``

    Raises ``ParameterFileError`` where plant and parameters are of another sampling rate.
    """
    _same_rate(plant, parameters)
    samples = len(reference)
    kept = Kept()
    begun = _begun(plant, kept, 0.0 if disturbance is None else float(disturbance[0]))
    controller = Controller(parameters.values, precision=precision)
    controller.start(plant.rest_voltage_V, _reading(plant, begun.w))
    preview = int(parameters.values["preview_samples"])
    ahead = np.minimum(np.arange(samples) + preview, samples - 1)
    inputs = {
        "reference": np.ascontiguousarray(reference[ahead]),
        "disturbance": _disturbance(plant, disturbance, samples),
        "noise": plant.noise(samples, rng),
        "fault": np.zeros(samples) if fault is None else np.ascontiguousarray(fault),
    }
    outputs = {name: np.empty(samples) for name in ("position", "measured", "voltage_V")}
    status = np.empty(samples, dtype=np.uint32)
    step, state, values = controller.addresses
    run = LoopRun(state=state, parameters=values, samples=samples, status=status.ctypes.data)
    setattr(run, f"step_{precision}", step)
    for name, array in {**inputs, **outputs}.items():
        setattr(run, name, kept.address(array))
    loop_library().pl_loop(ctypes.addressof(begun), ctypes.addressof(run))
    return LoopRecord(
        axis=plant.axis,
        sampling_rate_Hz=plant.sampling_rate_Hz,
        reference=np.asarray(reference, dtype=np.float64),
        status=status,
        **outputs,
    )


def rest_position(plant: AxisPlant) -> float:
    """Return where the axis stands at rest: m, or A of a junction."""
    return float(_begun(plant, Kept(), 0.0).w)


def _same_rate(plant: AxisPlant, parameters: AxisParameters) -> None:
    asked_Hz = float(parameters.values["sampling_rate_Hz"])
    if asked_Hz != plant.sampling_rate_Hz:
        raise ParameterFileError(
            f"axis {plant.axis}: parameters for {asked_Hz:g} Hz, a plant sampled at "
            f"{plant.sampling_rate_Hz:g} Hz",
            needed="one sampling rate",
            remedy="Make the plant for the rate of the parameter file.",
        )


def _reading(plant: AxisPlant, sensed: float) -> float:
    kept = float(np.clip(sensed, *plant.reading_range))
    step = plant.reading_step
    return step * round(kept / step) if step > 0 else kept


def _disturbance(plant: AxisPlant, given: Array | None, samples: int) -> Array:
    found = np.zeros(samples + 1)
    if given is not None:
        found[:-1], found[-1] = given, given[-1]
    if isinstance(plant.response, Junction):
        found += plant.response.gain_nepers_per_V * plant.rest_voltage_V
    return found


def _begun(plant: AxisPlant, kept: Kept, disturbance: float) -> LoopPlant:
    """Return the plant as the loop takes it, settled at its rest voltage."""
    rate_Hz = plant.sampling_rate_Hz * SUBSTEPS
    response, rest_V = plant.response, plant.rest_voltage_V
    gain = response.gain_nepers_per_V if isinstance(response, Junction) else 1.0
    begun = LoopPlant(substeps=SUBSTEPS)
    begun.reading_lsb = plant.reading_step
    begun.reading_least, begun.reading_most = plant.reading_range
    before, after = _before(plant, rate_Hz, gain, kept), _after(plant, rate_Hz, kept)
    begun.before, begun.after = before.linear, after.linear
    if isinstance(response, Junction):
        begun.kind, begun.current_A = _EXPONENTIAL, response.current_A
        disturbance += gain * rest_V
    elif isinstance(response, Hysteresis):
        begun.kind = _PLAYS
        _fill_hysteresis(begun, response, kept)
    else:
        begun.kind, begun.respond = _PLUGGED, RESPOND(response.begin(rest_V))
        kept.arrays.append(begun.respond)
    address = ctypes.addressof(begun)
    begun.w = loop_library().pl_response(address, gain * rest_V, disturbance)
    before.settle(rest_V)
    after.settle(begun.w)
    return begun


def _fill_hysteresis(begun: LoopPlant, response: Hysteresis, kept: Kept) -> None:
    operator = response.operator
    begun.plays = len(operator.plays.threshold)
    begun.threshold_V = kept.address(operator.plays.threshold)
    begun.weight = kept.address(operator.plays.weight)
    begun.play_V = kept.address(np.array(operator.virgin_memory()))
    begun.envelope, begun.zones = (
        _map(part, kept) for part in (operator.envelope, operator.dead_zones)
    )
    begun.polarity = response.polarity
    begun.voltage_offset_V = operator.voltage_offset_V
    begun.displacement_offset_m = operator.displacement_offset_m


def _map(zones: DeadZones, kept: Kept) -> Map:
    slope = np.ascontiguousarray(zones.slope)
    return Map(
        knots=len(zones.threshold),
        knot=kept.address(zones.threshold),
        slope=kept.address(slope),
        zero=zones.zero,
    )


def cascade(sections: Sequence[Section]) -> tuple[Array, Array, list[int]]:
    """Return A and B of sections of unit gain one behind the other, and the output state of each.

    A first-order section is one state; one with damping two, of which the first is its output.
    """
    orders = [1 if section.damping is None else 2 for section in sections]
    A, B = np.zeros((sum(orders), sum(orders))), np.zeros(sum(orders))
    outputs: list[int] = []
    place = 0
    for section, order in zip(sections, orders, strict=True):
        w = 2.0 * np.pi * section.frequency_Hz
        driven = place + order - 1
        if section.damping is None:
            A[place, place] = -w
        else:
            A[place, driven] = w
            A[driven, place], A[driven, driven] = -w, -2.0 * section.damping * w
        if outputs:
            A[driven, outputs[-1]] = w
        else:
            B[driven] = w
        outputs.append(place)
        place += order
    return A, B, outputs


def _before(plant: AxisPlant, rate_Hz: float, gain: float, kept: Kept) -> _Block:
    """Return amplifier and delay behind the converter's hold."""
    sections = plant.amplifier or (Section(frequency_Hz=_QUICK * rate_Hz / (2.0 * np.pi)),)
    A, B, outputs = cascade(sections)
    system = ContinuousSystem(
        A=A,
        B=B[:, None],
        C=np.eye(len(A))[outputs[-1]][None, :],
        D=np.zeros((1, 1)),
        delay_s=plant.delay_s,
    )
    held = sample(system, rate_Hz)
    rows = np.vstack([gain * held.C, np.zeros_like(held.C)])
    return _block(held.A, (held.B[:, 0], np.zeros(len(held.A))), rows, (0.0, 0.0), kept)


def _after(plant: AxisPlant, rate_Hz: float, kept: Kept) -> _Block:
    """Return mechanics and sensor behind a signal that is straight between substeps.

    x[k+1] = e^(A h) x[k] + G_1 w[k] + G_2 (w[k+1] - w[k])
    """
    A, B, C, D = _behind(plant)
    states = len(A)
    line = np.zeros((states + 2, states + 2))
    line[:states, :states], line[:states, states] = A / rate_Hz, B / rate_Hz
    line[states, states + 1] = 1.0
    moved = expm(line)[:states]
    held, ramp = moved[:, states], moved[:, states + 1]
    return _block(moved[:, :states], (held - ramp, ramp), C, D, kept)


def _behind(plant: AxisPlant) -> tuple[Array, Array, Array, tuple[float, float]]:
    """Return what stands behind the response: A, B, and the rows of position and sensed."""
    if plant.measured is not None:
        A, B = plant.measured.A, plant.measured.B[:, 0]
        row, direct = plant.measured.C[0], float(plant.measured.D[0, 0])
        rest = direct - float(row @ np.linalg.solve(A, B))
        return A, B, np.stack([row, row]) / rest, (direct / rest, direct / rest)
    A, B, outputs = cascade((*plant.mechanics, *plant.sensor))
    C, D = np.zeros((2, len(A))), [0.0, 0.0]
    for row_of, sections in enumerate((len(plant.mechanics), len(outputs))):
        if sections:
            C[row_of, outputs[sections - 1]] = 1.0
        else:
            D[row_of] = 1.0
    return A, B, C, (D[0], D[1])


def _block(
    A: Array, drive: tuple[Array, Array], C: Array, D: tuple[float, float], kept: Kept
) -> _Block:
    """Build a block; ``drive`` holds B_old and B_new."""
    old, new = drive
    if len(A) > MAX_STATES:
        raise ValueError(f"the plant has {len(A)} states in one block, at most {MAX_STATES}")
    x = np.zeros(len(A))
    linear = Linear(states=len(A), x=kept.address(x))
    for name, array in {"A": A, "B_old": old, "B_new": new, "C": C}.items():
        setattr(linear, name, kept.address(np.ascontiguousarray(array, dtype=np.float64)))
    linear.D[:] = D
    return _Block(linear=linear, A=A, B=old + new, x=x)
