"""Outsiders' simulators, compiled once, and their plants under a controller."""

import ctypes
import os
import subprocess
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.runtime.controller import Controller

HERE = Path(__file__).parent
NAMES = ("birch", "alder")
RATE_Hz = 20e3
BUILD = Path(f"build/outsiders/{os.getpid()}")  # processes compile beside each other


@dataclass(frozen=True, kw_only=True, eq=False)
class Simulator:
    """One outsider's code: what writes recordings, and the compiled plants."""

    name: str
    campaigns: ModuleType
    library: ctypes.CDLL


@cache
def simulator(name: str) -> Simulator:
    """Compile and open one outsider's simulator."""
    campaigns = import_module(f"benchmarks.outsiders.{name}.campaigns")
    folder = BUILD / name
    folder.mkdir(parents=True, exist_ok=True)
    library = campaigns.build(folder.absolute())
    for kind in ("stage", "tip"):
        getattr(library, f"{kind}_open").restype = ctypes.c_void_p
        getattr(library, f"{kind}_close").argtypes = (ctypes.c_void_p,)
    library.stage_open.argtypes = (ctypes.c_uint32, ctypes.c_uint32)
    library.stage_rest.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)
    library.tip_open.argtypes = (ctypes.c_uint32, ctypes.c_uint32, ctypes.c_double)
    library.tip_move_surface.argtypes = (ctypes.c_void_p, ctypes.c_double)
    library.tip_fault.argtypes = (ctypes.c_void_p, ctypes.c_int)
    return Simulator(name=name, campaigns=campaigns, library=library)


class _Run(ctypes.Structure):
    _fields_ = (
        *((n, ctypes.c_void_p) for n in ("step", "state", "parameters", "plant_step", "plant")),
        ("ticks", ctypes.c_size_t),
        *((n, ctypes.c_void_p) for n in ("reference", "position", "measured", "volts", "status")),
        ("first_measured", ctypes.c_double),
    )


@cache
def _loop() -> ctypes.CDLL:
    BUILD.mkdir(parents=True, exist_ok=True)
    made = (BUILD / "loop.so").absolute()
    command = ("cc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run((*command, str(HERE / "loop.c"), "-o", str(made)), check=True)
    return ctypes.CDLL(str(made))


@dataclass(frozen=True, kw_only=True, eq=False)
class Driven:
    """What happened: position (m; of a tip its gap), reading, drive and status at every tick.

    rest  displacement shown before the first tick
    """

    position: Array
    measured: Array
    volts: Array
    status: Array
    rest: float


def drive(
    controller: Controller, step: object, plant: int, reference: Array, first: float
) -> Driven:
    """Run a started controller on an open plant."""
    ticks = len(reference)
    given = np.ascontiguousarray(reference, dtype=np.float64)
    out = {name: np.empty(ticks) for name in ("position", "measured", "volts")}
    status = np.empty(ticks, dtype=np.uint32)
    address, state, parameters = controller.addresses
    run = _Run(
        step=address,
        state=state,
        parameters=parameters,
        plant_step=ctypes.cast(step, ctypes.c_void_p),  # type: ignore[arg-type]
        plant=plant,
        ticks=ticks,
        reference=given.ctypes.data,
        status=status.ctypes.data,
        first_measured=first,
        **{name: array.ctypes.data for name, array in out.items()},
    )
    _loop().outsider_loop(ctypes.byref(run))
    return Driven(**out, status=status, rest=first)


def track(
    made: Simulator, seed: int, noise_seed: int, values: dict, reference: Array | None, path=None
) -> Driven:
    """Open a stage at rest, start a controller on it, and let it follow a reference.

    reference  (ticks,)  m, absolute; None: ``path`` makes it of the displacement at rest
    """
    plant = made.library.stage_open(seed, noise_seed)
    volts, rest = ctypes.c_double(), ctypes.c_double()
    made.library.stage_rest(plant, ctypes.byref(volts), ctypes.byref(rest))
    controller = Controller(values)
    controller.start(volts.value, rest.value)
    wanted = path(rest.value) if reference is None else reference
    found = drive(controller, made.library.stage_step, plant, wanted, rest.value)
    made.library.stage_close(plant)
    return found
