"""Co-simulation units of the identified plants, for the target `fmu`.

plant_of_axis.h contains an identified plant at rest, as constants of the structure of
plant_loop.c. The numbers are read from the structure that verification uses, so that there is one
forward model. They are printed as the shortest decimals that read as the same doubles.
"""

from collections.abc import Mapping, Sequence
from importlib.resources import files

import numpy as np

from piezoid.export.bundle import SAMPLES
from piezoid.export.c_header import plain_ascii
from piezoid.export.fmu import Unit
from piezoid.operators.dead_zone import KernelMap
from piezoid.verification.loop_plant import Linear, SettledPlant
from piezoid.verification.plant import AxisPlant, Junction

_SCALARS = (
    *("substeps", "late", "kind", "plays", "edges", "low_V", "high_V"),
    *("activation_step", "activation_m", "irreversible_m", "second_plays", "second_powers"),
    *("second_centre_V", "second_reach_V", "cyclic_orders", "cyclic_per_m", "polarity"),
    *("voltage_offset_V", "displacement_offset_m", "current_A", "current_most"),
    *("slew_step", "driven", "w"),
    *("reading_zero", "reading_lsb", "reading_least", "reading_most"),
)
_BLOCK = ("A", "B_old", "B_new", "C")
_POINTERS = (
    *("threshold_V", "weight", "edge_V", "value_m", "second_threshold_V", "second_weight_m"),
    *("cyclic_cosine_m", "cyclic_sine_m"),
)
_ARRAYS = (
    *(
        f"{block}_{name}"
        for block in ("before", "after")
        for name in ("A", "B_old", "B_new", "x", "C")
    ),
    *("after_settled", "envelope_knot", "envelope_slope", "zones_knot", "zones_slope"),
    *("threshold_V", "play_V", "weight", "edge_V", "value_m"),
    *("second_threshold_V", "second_play_V", "second_weight_m"),
    *("cyclic_cosine_m", "cyclic_sine_m", "late_V", "hum_Hz", "hum"),
)

_SOURCES = ("fmu_plant.h", "plant_loop.c")


def plant_units(name: str, plants: Sequence[AxisPlant]) -> Mapping[str, Unit]:
    """Return the units of identified plants by the stem of their files' names.

    name  of the stage
    """
    package = files("piezoid.verification")
    sources = {source: package.joinpath(source).read_bytes() for source in _SOURCES}
    reading = "Reading at the sampling instant, with noise and rounding."
    position = "Position in front of the sensor at the sampling instant."
    noise = "Factor of the identified noise and lines in the reading; 0: none."
    seed = "Seed of the noise."
    units = {}
    for plant in plants:
        rest_V = plant.rest_voltage_V
        unit, input_name = "m", "disturbance_m"
        disturbance = "Motion of the stage that the drive does not cause"
        if isinstance(plant.response, Junction):
            unit, input_name = "A", "withdrawn_m"
            disturbance = "Distance of the surface below its position at rest"
        disturbance += ", at the end of the period; linear during the period."
        units[f"{plant.axis}_plant"] = Unit(
            identifier=f"piezoid_{plant.axis}_plant",
            description=f"Identified plant of axis {plant.axis} of the stage {plain_ascii(name)}, "
            f"at rest at {rest_V!r} V",
            header="fmu_plant.h",
            macros="",
            variables=(
                ("voltage_V", "input", "V", rest_V, "The command, held for a period."),
                (input_name, "input", "m", 0.0, disturbance),
                (f"measured_{unit}", "output", unit, None, reading),
                (f"position_{unit}", "output", unit, None, position),
                ("noise_factor", "parameter", "1", 1.0, noise),
                ("noise_seed", "parameter", None, 0, seed),
            ),
            sources={**sources, "plant_of_axis.h": plant_header(plant).encode()},
            period_s=1.0 / plant.sampling_rate_Hz,
            samples=SAMPLES,
        )
    return units


def plant_header(plant: AxisPlant) -> str:
    """Return the text of plant_of_axis.h.

    Raises ``ParameterFileError`` for a plant with more states than plant_loop.c allows.
    """
    settled = SettledPlant(plant)
    initial = settled.structure
    decay, offset = 1.0, 0.0
    if isinstance(plant.response, Junction):
        decay = plant.response.decay_per_m
        offset = plant.response.gain_nepers_per_V * plant.rest_voltage_V
    pole, rate_Hz = 0.0, plant.sampling_rate_Hz
    if plant.noise_bandwidth_Hz is not None:
        pole = float(np.exp(-2.0 * np.pi * plant.noise_bandwidth_Hz / rate_Hz))
    macros = {
        "RATE_Hz": rate_Hz,
        "REST_V": plant.rest_voltage_V,
        "DISTURBANCE_FACTOR": decay,
        "DISTURBANCE_AT_REST": offset,
        "NOISE_RMS": plant.noise_rms,
        "NOISE_POLE": pole,
        "NOISE_KICK": float(np.sqrt(1.0 - pole**2)),
        "LATE": max(initial.late, 1),
        "BEFORE_STATES": initial.before.states,
        "AFTER_STATES": max(initial.after.states, 1),
        "PLAYS": max(initial.plays, 1),
        "SECOND_PLAYS": max(initial.second_plays, 1),
        "HUMS": max(len(plant.hums), 1),
    }
    lines = ["/* The identified plant of an axis at rest, written by piezoid. SI units. */"]
    lines += [f"#define PLANT_{name} {_number(value)}" for name, value in macros.items()]
    arrays = settled.arrays
    states = initial.after.states
    driven = arrays["after_B_old"] + arrays["after_B_new"]
    transition = np.eye(states) - arrays["after_A"]
    arrays["after_settled"] = np.asarray(np.linalg.solve(transition, driven), dtype=np.float64)
    arrays["hum_Hz"] = np.array([frequency_Hz for frequency_Hz, _ in plant.hums])
    arrays["hum"] = np.array([amplitude for _, amplitude in plant.hums])
    for name in _ARRAYS:
        numbers = ", ".join(map(_number, arrays.get(name, np.zeros(0)).ravel())) or "0.0"
        lines.append(f"static const double plant_{name}[] = {{{numbers}}};")
    members = [f".{name} = {_number(getattr(initial, name))}" for name in _SCALARS]
    members += [
        f".before = {_linear('before', initial.before)}",
        f".after = {_linear('after', initial.after)}",
        f".envelope = {_map('envelope', initial.envelope)}",
        f".zones = {_map('zones', initial.zones)}",
    ]
    members += [f".{name} = plant_{name}" for name in _POINTERS]
    initialiser = "".join(f"    {member},\n" for member in members)
    return "\n".join([*lines, f"static const pl_plant plant_at_rest = {{\n{initialiser}}};", ""])


def _number(value: float) -> str:
    if isinstance(value, float) and np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(int(value)) if isinstance(value, int) else repr(float(value))


def _linear(name: str, block: Linear) -> str:
    pointers = ", ".join(f".{array} = plant_{name}_{array}" for array in _BLOCK)
    direct = ", ".join(_number(float(value)) for value in block.D)
    return f"{{.states = {block.states}, {pointers}, .D = {{{direct}}}}}"


def _map(name: str, curve: KernelMap) -> str:
    pointers = f".knot = plant_{name}_knot, .slope = plant_{name}_slope"
    return f"{{.knots = {curve.knots}, {pointers}, .zero = {curve.zero}}}"
