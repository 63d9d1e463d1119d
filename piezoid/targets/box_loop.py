"""An identified plant under whatever a box computes: the forward model of the verification."""

import ctypes
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification.loop_library import Kept, LoopRun, loop_library
from piezoid.verification.loop_plant import begun_plant
from piezoid.verification.plant import AxisPlant

Step = Callable[[float, float], float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Compiled:
    """A box in C, of the form of ``pz_step``: step(state, parameters, reference, measured).

    state  begins with two words, the second a status
    """

    step: int
    state: ctypes.Structure
    parameters: ctypes.Structure


_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoxRecord:
    """What happened, (samples,) each: m in front of the sensor and as read, and V."""

    position_m: Array
    measured_m: Array
    voltage_V: Array


def run_box(
    plant: AxisPlant,
    step: Step | Compiled,
    reference_m: Array,
    *,
    rng: np.random.Generator,
    disturbance_m: Array | None = None,
) -> BoxRecord:
    """Run a lateral axis from rest.

    step           called once a sample with reference and reading, m; returns V, or the same in C
    reference_m    (samples,)
    disturbance_m  (samples,)  at the response's output; None: none
    """
    samples = len(reference_m)
    kept = Kept()
    disturbed_m = np.zeros(samples + 1)
    if disturbance_m is not None:
        disturbed_m[:-1], disturbed_m[-1] = disturbance_m, disturbance_m[-1]
    begun = begun_plant(plant, kept, float(disturbed_m[0]))
    status = np.empty(samples, dtype=np.uint32)
    run = LoopRun(samples=samples, status=status.ctypes.data, reset_at=samples)
    if isinstance(step, Compiled):
        run.step_double, run.state = step.step, ctypes.addressof(step.state)
        run.parameters = ctypes.addressof(step.parameters)
    else:
        called = _STEP(lambda _state, _parameters, reference, measured: step(reference, measured))
        state = np.zeros(2, dtype=np.uint32)  # the loop looks for status behind the first word
        run.step_double = ctypes.cast(called, ctypes.c_void_p).value
        run.state = state.ctypes.data
    arrays = {
        "reference": np.ascontiguousarray(reference_m, dtype=np.float64),
        "disturbance": disturbed_m,
        "noise": plant.noise(samples, rng),
        "fault": np.zeros(samples),
    }
    arrays |= {name: np.empty(samples) for name in ("driven", "position", "measured", "voltage_V")}
    for name, array in arrays.items():
        setattr(run, name, kept.address(array))
    loop_library().pl_loop(ctypes.addressof(begun), ctypes.addressof(run))
    return BoxRecord(
        position_m=arrays["position"],
        measured_m=arrays["measured"],
        voltage_V=arrays["voltage_V"],
    )
