"""box.toml: what a box that somebody owns can hold."""

import ctypes
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.numerics.arrays import Array
from piezoid.toml_files import read_toml
from piezoid.verification.loop_library import Kept, LoopRun, loop_library
from piezoid.verification.loop_plant import begun_plant
from piezoid.verification.plant import AxisPlant

Step = Callable[[float, float], float]

SHAPES = ("triangle", "sine")
FORMATS = ("stabilizer", "pyrpl", "linien")
_LARGEST = 2**24  # points of a table
_NUMBERS = {
    "pi-pid": ("slew_V_per_s",),
    "biquad": ("update_Hz", "error_range_m"),
    "nanonis": ("drift_limit_percent", "frame_half_range_m"),
    "waveform": ("frequency_Hz", "rate_Hz", "half_range_m"),
}
_WHOLE = {
    "pi-pid": {"notches": (0, 2)},
    "biquad": {"sections": (1, 14)},
    "nanonis": {"table_points": (3, 1024)},
    "waveform": {"points": (4, _LARGEST), "bits": (8, 16)},
}
_ONE_OF: dict[str, dict[str, tuple[str, ...]]] = {
    "waveform": {"shape": SHAPES},
    "biquad": {"format": FORMATS},
}
_ENDS: dict[str, tuple[str, ...]] = {"waveform": ("range_V",), "biquad": ("output_V",)}
_TABLES = ", ".join(f"[{table}]" for table in _NUMBERS)


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


@dataclass(frozen=True, kw_only=True)
class Box:
    """What a box can hold; None: what the stage has.

    notches       0 to 2
    slew_V_per_s  its own limit; None: none
    format        of its sections, one of ``FORMATS``; None: each that holds them
    sections      at most;  update_Hz  at which it computes; None: as it is published
    error_range_m  of the difference, full scale; None: as far as references go
    output_V      command at the ends of its converter; None: the limits of the axis
    table_points  of a hysteresis table;  drift_limit_percent  of its range, for drift compensation
    frame_half_range_m  from the middle of a frame to its ends; None: 0.7 of the way to the limits
    shape         of the scan, ``triangle`` (rounded corners) or ``sine``
    frequency_Hz  of its lines to and fro
    half_range_m  from the middle of the scan to its ends; None: 0.7 of the way to the limits
    rate_Hz       at which points are put out; None: the controller's
    points        that the table has room for
    bits          of its converter
    range_V       its ends; None: those of the stage's own
    """

    notches: int = 2
    slew_V_per_s: float | None = None
    format: str | None = None
    sections: int | None = None
    update_Hz: float | None = None
    error_range_m: float | None = None
    output_V: tuple[float, float] | None = None
    table_points: int = 32
    drift_limit_percent: float = 10.0
    frame_half_range_m: float | None = None
    shape: str = "triangle"
    frequency_Hz: float = 10.0
    half_range_m: float | None = None
    rate_Hz: float | None = None
    points: int = _LARGEST
    bits: int = 16
    range_V: tuple[float, float] | None = None


def read_box(place: Path) -> Box:
    """Return what a file declares; ``ParameterFileError`` names the key and what it takes."""
    try:
        tables = read_toml(place.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ParameterFileError(
            f"{place} cannot be read: {error}",
            needed=f"a TOML file with tables of {_TABLES}",
            remedy="Correct it, or leave --box away: then the defaults of the guide hold.",
        ) from None
    given: dict[str, Any] = {}
    for table, keys in tables.items():
        if table not in _NUMBERS or not isinstance(keys, Mapping):
            raise _wrong(place, table, "no table of it", _TABLES)
        for key, value in keys.items():
            given[key] = _checked(place, table, key, value)
    return Box(**given)


def _checked(place: Path, table: str, key: str, value: object) -> object:
    where = f"{key} of [{table}]"
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if key in _NUMBERS[table]:
        if not is_number or not 0.0 < float(str(value)) < 1e12:
            raise _wrong(place, where, repr(value), "a number above 0")
        return float(str(value))
    if key in _WHOLE[table]:
        least, most = _WHOLE[table][key]
        if not is_number or not isinstance(value, int) or not least <= value <= most:
            raise _wrong(place, where, repr(value), f"a whole number from {least} to {most}")
        return value
    known = _ONE_OF.get(table, {}).get(key)
    if known is not None:
        if value not in known:
            raise _wrong(place, where, repr(value), " or ".join(known))
        return value
    if key in _ENDS.get(table, ()):
        if (
            not isinstance(value, list)
            or len(value) != 2
            or not all(isinstance(v, int | float) and abs(v) < 1e6 for v in value)
            or not value[0] < value[1]
        ):
            raise _wrong(place, where, repr(value), "two voltages, the lower first")
        return (float(value[0]), float(value[1]))
    keys = (*_NUMBERS[table], *_WHOLE[table], *_ONE_OF.get(table, ()), *_ENDS.get(table, ()))
    raise _wrong(place, where, "no key of it", f"one of {', '.join(keys)}")


def _wrong(place: Path, where: str, what: str, needed: str) -> ParameterFileError:
    return ParameterFileError(
        f"{place}: {where} is {what}", needed=needed, remedy="Correct it, and export again."
    )
