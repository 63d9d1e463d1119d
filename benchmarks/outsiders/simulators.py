"""Compiled simulators by third parties, and their plants under a controller."""

import ctypes
import os
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Protocol

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller

FOLDER = Path(__file__).parent
NAMES = ("birch", "alder")
RATE_Hz = 20e3
BUILD = Path(f"build/outsiders/{os.getpid()}")  # processes compile at the same time
_STEP = ctypes.CFUNCTYPE(
    ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double, ctypes.c_double
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """One simulator: the module that writes recordings, and the compiled plants."""

    name: str
    campaigns: ModuleType
    library: ctypes.CDLL

    def stage_law(self, seed: int) -> str:
        """Return the name of a stage's hysteresis law."""
        return str(self.campaigns.stage_truth(seed, self.library).get("law", "?"))

    def open_stage(self, seed: int, noise_seed: int) -> tuple[int, float, float]:
        """Open a stage at rest; return its handle, its drive [V] and its displacement [m]."""
        plant = self.library.stage_open(seed, noise_seed)
        voltage_V, rest_m = ctypes.c_double(), ctypes.c_double()
        self.library.stage_rest(plant, ctypes.byref(voltage_V), ctypes.byref(rest_m))
        return plant, voltage_V.value, rest_m.value


@cache
def load_simulator(name: str) -> Simulator:
    """Compile and load a simulator."""
    campaigns = import_module(f"benchmarks.outsiders.{name}.campaigns")
    folder = BUILD / name
    folder.mkdir(parents=True, exist_ok=True)
    library = campaigns.build(folder.absolute())
    for device in ("stage", "tip"):
        getattr(library, f"{device}_open").restype = ctypes.c_void_p
        getattr(library, f"{device}_close").argtypes = (ctypes.c_void_p,)
    library.stage_open.argtypes = (ctypes.c_uint32, ctypes.c_uint32)
    library.stage_rest.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    library.tip_open.argtypes = (ctypes.c_uint32, ctypes.c_uint32, ctypes.c_double)
    library.tip_move_surface.argtypes = (ctypes.c_void_p, ctypes.c_double)
    library.tip_fault.argtypes = (ctypes.c_void_p, ctypes.c_int)
    return Simulator(name=name, campaigns=campaigns, library=library)


class ControllerAddresses(Protocol):
    """A started controller whose step has the C interface of ``pz_step``."""

    @property
    def addresses(self) -> tuple[int | None, int, int]:
        """Addresses of step function, state and parameters."""


class PythonController:
    """A controller step in Python with the C interface of ``pz_step``.

    step   (reference, measured) -> drive [V]
    state  addresses of state and parameters; by default a status word of 0
    """

    def __init__(
        self, step: Callable[[float, float], float], state: tuple[int, int] | None = None
    ) -> None:
        self._step = _STEP(lambda _s, _p, reference, measured: step(reference, measured))
        self._status = (ctypes.c_uint32 * 2)()
        self._state = state or (ctypes.addressof(self._status),) * 2

    @property
    def addresses(self) -> tuple[int | None, int, int]:
        """Addresses of step function, state and parameters."""
        return ctypes.cast(self._step, ctypes.c_void_p).value, *self._state


class _LoopArguments(ctypes.Structure):
    _fields_ = (
        *((n, ctypes.c_void_p) for n in ("step", "state", "parameters", "plant_step", "plant")),
        ("ticks", ctypes.c_size_t),
        *((n, ctypes.c_void_p) for n in ("reference", "position", "measured", "volts", "status")),
        ("first_measured", ctypes.c_double),
    )


@cache
def _loop() -> ctypes.CDLL:
    BUILD.mkdir(parents=True, exist_ok=True)
    library = (BUILD / "loop.so").absolute()
    command = ("cc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run((*command, str(FOLDER / "loop.c"), "-o", str(library)), check=True)
    return ctypes.CDLL(str(library))


@dataclass(frozen=True, kw_only=True, eq=False)
class LoopRun:
    """Position (m; gap of a tip), measurement, drive and status at every tick of a closed loop.

    rest  measurement before the first tick
    """

    position: Array
    measured: Array
    volts: Array
    status: Array
    rest: float


def drive(
    controller: ControllerAddresses, step: object, plant: int, reference: Array, first: float
) -> LoopRun:
    """Run a started controller on an open plant.

    step   step function of the plant
    first  measurement before the first tick
    """
    ticks = len(reference)
    references = np.ascontiguousarray(reference, dtype=np.float64)
    outputs = {name: np.empty(ticks) for name in ("position", "measured", "volts")}
    status = np.empty(ticks, dtype=np.uint32)
    address, state, parameters = controller.addresses
    arguments = _LoopArguments(
        step=address,
        state=state,
        parameters=parameters,
        plant_step=ctypes.cast(step, ctypes.c_void_p),  # type: ignore[arg-type]
        plant=plant,
        ticks=ticks,
        reference=references.ctypes.data,
        status=status.ctypes.data,
        first_measured=first,
        **{name: array.ctypes.data for name, array in outputs.items()},
    )
    _loop().outsider_loop(ctypes.byref(arguments))
    return LoopRun(**outputs, status=status, rest=first)


def track(
    simulator: Simulator,
    seed: int,
    noise_seed: int,
    values: dict,
    reference_from: Callable[[float], Array],
) -> LoopRun:
    """Run the compiled controller on a stage that starts at rest.

    values          parameters of the controller
    reference_from  displacement at rest [m] -> reference [m], (ticks,)
    """
    plant, voltage_V, rest_m = simulator.open_stage(seed, noise_seed)
    controller = Controller(values)
    controller.start(voltage_V, rest_m)
    step = simulator.library.stage_step
    run = drive(controller, step, plant, reference_from(rest_m), rest_m)
    simulator.library.stage_close(plant)
    return run


def seed_range(text: str) -> range:
    """Return the seeds of a text such as ``700-711`` or ``700``; no seeds for an empty text."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1) if text else range(0)
