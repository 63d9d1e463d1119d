"""Simulate the compiled controller with the exported values and a plant, sample by sample.

This module also has the range of an axis' references, and the approach from rest to a path.
"""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters
from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller
from piezoid.verification.loop_plant import LoopRun, SettledPlant, loop_library
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.tracking import LoopRecord

_REACH = 0.7  # of the distance from the middle of the references to their ends
_APPROACH_s, _PAUSE_s = 0.4, 0.2  # nine periods of the slowest loop (45 Hz) of simulated stages
_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)


class Fault(IntEnum):
    """Fault of a sensor, by its reading instead of the measured value."""

    SOUND = 0
    FROZEN = 1  # repeats the last reading
    DEAD = 2  # offset and noise only
    REVERSED = 3  # current of the wrong sign
    FULL = 4  # end of the range


def run_axis(
    plant: AxisPlant,
    parameters: AxisParameters,
    reference: Array,
    *,
    rng: np.random.Generator,
    disturbance: Array | None = None,
    added_m: Array | None = None,
    fault: Array | None = None,
    reset_at: int | None = None,
    has_approach: bool = False,
    precision: str = "double",
) -> LoopRecord:
    """Simulate one axis from rest, with the exported parameters.

    reference    (samples,)  m (junction: A); passed to the runtime ahead by its preview
    disturbance  (samples,)  m at the response's output (junction: nepers, subtracted from ln i)
    added_m      (samples,)  m added to position and reading
    fault        (samples,)  a ``Fault`` in every sample; NaN: the reading is NaN
    reset_at     sample before which the controller is reset; None: never
    has_approach whether the axis moves from rest to the first reference, as ``approach_path``
                 does, before the record begins
    precision    of the runtime, ``double`` or ``float``

    Raises ``ParameterFileError`` if plant and parameters have different sampling rates.
    """
    rate_Hz = parameters.sampling_rate_Hz
    if rate_Hz != plant.sampling_rate_Hz:
        raise ParameterFileError(
            f"axis {plant.axis}: parameters for {rate_Hz:g} Hz, a plant sampled at "
            f"{plant.sampling_rate_Hz:g} Hz",
            needed="one sampling rate",
            remedy="Make the plant for the rate of the parameter file.",
        )
    approach = approach_path(plant, float(reference[0])) if has_approach else np.zeros(0)
    lead, samples = len(approach), len(approach) + len(reference)
    reference = np.concatenate([approach, reference])
    if disturbance is not None:
        disturbance = np.pad(disturbance, (lead, 0), "edge")
    added = np.zeros(samples) if added_m is None else np.pad(added_m, (lead, 0), "edge")
    settled = SettledPlant(plant, disturbance)
    preview = int(parameters.values["preview_samples"])
    ahead = np.minimum(np.arange(samples) + preview, samples - 1)
    controller = Controller(parameters.values, precision=precision)
    reading = float(np.clip(settled.rest_position, *plant.reading_range))
    step = plant.reading_step
    controller.start(plant.rest_voltage_V, step * round(reading / step) if step > 0 else reading)
    function, state, values = controller.addresses
    run = LoopRun(state=state, parameters=values, samples=samples)
    run.reset = controller.reset_address
    run.reset_at = samples if reset_at is None else lead + reset_at
    setattr(run, f"step_{precision}", function)
    fault = np.zeros(samples) if fault is None else np.pad(fault, (lead, 0))
    noise = plant.noise(samples, rng) + added
    record = _run_loop(settled, run, reference[ahead], noise, disturbance, fault)
    return replace(record, reference=reference, position=record.position + added).after(lead)


def run_law(
    plant: AxisPlant,
    law: Callable[[float, float], float],
    reference: Array,
    *,
    rng: np.random.Generator,
    disturbance: Array | None = None,
) -> LoopRecord:
    """Simulate one lateral axis from rest with a control law in Python; the status is always 0.

    law          called once a sample with reference and reading, m; returns V
    reference    (samples,)  m
    disturbance  (samples,)  m at the response's output; None: none
    """
    samples = len(reference)
    step = _STEP(lambda _state, _parameters, reference_m, measured: law(reference_m, measured))
    state = np.zeros(2, dtype=np.uint32)  # the loop reads the status from the second word
    run = LoopRun(state=state.ctypes.data, samples=samples, reset_at=samples)
    run.step_double = ctypes.cast(step, ctypes.c_void_p).value
    settled = SettledPlant(plant, disturbance)
    noise = plant.noise(samples, rng)
    return _run_loop(settled, run, reference, noise, disturbance, np.zeros(samples))


def _run_loop(
    settled: SettledPlant,
    run: LoopRun,
    reference: Array,
    noise: Array,
    disturbance: Array | None,
    fault: Array,
) -> LoopRecord:
    plant, samples = settled.plant, run.samples
    padded = np.zeros(samples + 1)
    if disturbance is not None:
        padded[:-1], padded[-1] = disturbance, disturbance[-1]
    if isinstance(plant.response, Junction):
        padded += plant.response.gain_nepers_per_V * plant.rest_voltage_V
    inputs = {"reference": reference, "disturbance": padded, "noise": noise, "fault": fault}
    outputs = {name: np.empty(samples) for name in ("driven", "position", "measured", "voltage_V")}
    status = np.empty(samples, dtype=np.uint32)
    run.status = status.ctypes.data
    settled.point(run, **inputs, **outputs)
    loop_library().pl_loop(ctypes.addressof(settled.structure), ctypes.addressof(run))
    return LoopRecord(
        axis=plant.axis,
        sampling_rate_Hz=plant.sampling_rate_Hz,
        reference=reference,
        status=status,
        unit="A" if isinstance(plant.response, Junction) else "m",
        **outputs,
    )


@dataclass(frozen=True, kw_only=True)
class ReferenceRange:
    """Allowed references of an axis: at most ``farthest_m`` away from ``centre_m``."""

    centre_m: float
    farthest_m: float

    @property
    def radius_m(self) -> float:
        """Radius of the paths in scenarios."""
        return _REACH * self.farthest_m


def reference_range(axis: AxisParameters) -> ReferenceRange:
    """Return the range of the allowed references of an axis."""
    low_m, high_m = (float(axis.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    return ReferenceRange(centre_m=0.5 * (low_m + high_m), farthest_m=0.5 * (high_m - low_m))


def approach_path(plant: AxisPlant, begin_m: float) -> Array:
    """Return the reference from rest to the start of a path, and a pause there, (samples,).

    The approach is half a cosine, as by a user: its hysteresis is part of the error, the transient
    of a jump would not be.
    """
    rest_m, rate_Hz = SettledPlant(plant).rest_position, plant.sampling_rate_Hz
    share = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, round(_APPROACH_s * rate_Hz)))
    pause_m = np.full(round(_PAUSE_s * rate_Hz), begin_m)
    return np.concatenate([rest_m + (begin_m - rest_m) * share, pause_m])
