"""Parameters of the runtime in one table. All other code about parameters loops over it.

The C structure is written by hand, because engineers read it; its layout, names and bounds are
compared with this table when the library is loaded (library.py) and its size when it is compiled.
"""

import ctypes
from dataclasses import dataclass
from math import prod
from typing import Any

SCHEMA = "piezoid.params/1"
VERSION = 2

MAX_PLAYS = 32
MAX_KNOTS = 32
MAX_EDGES = 9
MAX_RELAXATIONS = 8
MAX_SECTIONS = 4
MAX_ORDER = 16
MAX_TAPS = 32

METHODS = ("none", "mpi", "dob", "mpi_dob", "rst")
_METHOD_NUMBERS = ", ".join(f"{number} {name}" for number, name in enumerate(METHODS))
METHOD_NAMES = {  # for readers, the key in brackets
    "none": "static gain (none)",
    "mpi": "inverse (mpi)",
    "dob": "observer (dob)",
    "mpi_dob": "inverse and observer (mpi_dob)",
    "rst": "R, S, T (rst)",
}

# Unit and bounds of values that only their unit bounds.
_V, _m = ("V", -1e4, 1e4), ("m", -1e3, 1e3)
_VOLTAGE_STEP, _STEP = ("V", 0, 1e5), ("m", 0, 1e4)
_WEIGHT, _SECTION, _TAP = ("1", -1e6, 1e6), ("1", -1e9, 1e9), (-1e9, 1e9)
_GAIN = (-1e12, 1e12)
_LOG = ("1", 0, 1e3)


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """One member of the runtime's parameter structure.

    name          the member, with its unit
    kind          ``integer`` (32 bits) or ``real`` (float or double, as the runtime is built)
    shape         () for one number; unused places of an array hold 0
    unit          SI; ``1`` for none
    meaning       half a sentence
    lower, upper  every element lies between them, ends included
    default       what stands there when nothing is said
    """

    name: str
    kind: str
    unit: str
    meaning: str
    lower: float
    upper: float
    shape: tuple[int, ...] = ()
    default: float = 0.0

    @property
    def count(self) -> int:
        """Number of elements."""
        return prod(self.shape)


def _real(
    name: str,
    unit: str,
    lower: float,
    upper: float,
    meaning: str,
    *shape: int,
    kind: str = "real",
    default: float = 0.0,
) -> Parameter:
    return Parameter(
        name=name,
        kind=kind,
        unit=unit,
        meaning=meaning,
        lower=lower,
        upper=upper,
        shape=shape,
        default=default,
    )


def _integer(
    name: str, upper: float, meaning: str, *, unit: str = "1", lower: float = 0, default: float = 0
) -> Parameter:
    return _real(name, unit, lower, upper, meaning, kind="integer", default=default)


_HEADER = (
    _integer("schema", VERSION, "version of this table", lower=VERSION, default=VERSION),
    # Depends on the precision; the library fills it in and checks it.
    _integer("size_bytes", 2**24, "size of the structure", unit="byte"),
    _integer("checksum", 2**32 - 1, "CRC-32 of everything below"),
)

_COUNTS = (
    _integer("method", len(METHODS) - 1, "control method, PZ_METHOD_...: " + _METHOD_NUMBERS),
    _integer(
        "polarity",
        1,
        "1, or -1 where the displacement falls as the drive rises",
        lower=-1,
        default=1,
    ),
    _integer("play_count", MAX_PLAYS, "plays in use, that of half-width 0 included"),
    _integer("knot_count", MAX_KNOTS, "knots of the dead zones, that at 0 included; 0: none"),
    _integer("envelope_count", MAX_KNOTS, "knots of the envelope, that at 0 included; 0: none"),
    _integer("edge_count", MAX_EDGES, "edges of the play functions phi_i; 0: phi_i(z) = w_i z"),
    _integer(
        "edge_steps", MAX_PLAYS, "distance of the edges, as a multiple of play_threshold_V[1]"
    ),
    _integer("relaxation_count", MAX_RELAXATIONS, "creep elements in use"),
    _integer("reference_section_count", MAX_SECTIONS, "biquads on the reference"),
    _integer("command_section_count", MAX_SECTIONS, "biquads on the linearised command"),
    _integer("observer_order", MAX_ORDER, "observer states, the disturbance not counted"),
    _integer("preview_samples", 1e6, "samples by which the reference is given ahead"),
    _integer("stuck_samples", 1e6, "equal readings in a row before a sensor is stuck; 0: off"),
    _integer("blind_samples", 1e6, "position axis: unusable readings before a latch; 0: no latch"),
    _integer("bad_samples", 1e6, "tip axis: unusable currents in a row before a retract"),
    _integer("retract_samples", 1e6, "tip axis: first retract; each further one doubles"),
    _integer("contact_samples", 1e6, "tip axis: samples in a row at the set point before contact"),
    _integer("trip_limit", 1e6, "tip axis: retracts in a row before a latch; 0: no latch"),
    _integer("trip_samples", 1e6, "tip axis: samples without retract before its count restarts"),
    _integer("rst_T_count", MAX_TAPS, "coefficients of T"),
    _integer("rst_R_count", MAX_TAPS, "coefficients of R"),
    _integer("rst_S_count", MAX_TAPS, "coefficients of S, its integrator not counted"),
    _integer("rst_A0_count", MAX_TAPS, "coefficients of the anti-windup polynomial"),
)

_SIGNALS = (
    _real("sampling_rate_Hz", "Hz", 1, 1e7, "rate at which pz_step is called", default=20000),
    _real("gain_m_per_V", "m/V", 0, 1e3, "static gain of the affine model"),
    _real("voltage_offset_V", *_V, "centre of the model, voltage"),
    _real("displacement_offset_m", *_m, "centre of the model, position"),
    _real("voltage_minimum_V", *_V, "lowest output"),
    _real("voltage_maximum_V", *_V, "highest output"),
    _real(
        "voltage_step_V", *_VOLTAGE_STEP, "largest change of the voltage in a sample; 0: unlimited"
    ),
    _real("lsb_V", "V", 0, 1e3, "converter step; 0: no rounding"),
    _real("reference_minimum_m", *_m, "lowest reference followed"),
    _real("reference_maximum_m", *_m, "highest reference followed"),
    _real("reference_step_m", *_STEP, "largest change of the reference in a sample; 0: unlimited"),
    _real(
        "certified_step_m",
        *_STEP,
        "largest change of the reference in a sample with a proven error limit; 0: none",
    ),
    _real("displacement_minimum_m", *_m, "lowest plausible measurement"),
    _real("displacement_maximum_m", *_m, "highest plausible measurement"),
    _real("stuck_voltage_V", *_VOLTAGE_STEP, "voltage change that a working sensor shows"),
)

_MODEL = (
    _real("play_threshold_V", "V", 0, 1e4, "half-widths of the plays", MAX_PLAYS),
    _real("play_weight_m_per_V", "m/V", -1e3, 1e3, "weights of the plays", MAX_PLAYS),
    _real("play_memory_V", *_V, "states from which pz_start begins; 0: de-poled", MAX_PLAYS),
    _real("knot_m", *_m, "dead-zone thresholds", MAX_KNOTS),
    _real("knot_weight", *_WEIGHT, "dead zones: slope at 0 and its changes", MAX_KNOTS),
    _real("envelope_knot_V", *_V, "knots of the envelope in front of the plays", MAX_KNOTS),
    _real("envelope_weight", *_WEIGHT, "envelope: slope at 0 and its changes", MAX_KNOTS),
    _real("edge_V", *_V, "lowest edge of the play functions"),
    _real(
        "play_value_m",
        "m",
        -1e3,
        1e3,
        "values of each play function phi_i at its edges",
        MAX_PLAYS,
        MAX_EDGES,
    ),
    _real("relaxation_rate", "1", 0, 1, "creep: 1 - exp(-T_s / tau_i)", MAX_RELAXATIONS),
    _real(
        "relaxation_share",
        "1",
        -1,
        1,
        "creep: displacement added per displacement",
        MAX_RELAXATIONS,
    ),
    _real(
        "reference_section", *_SECTION, "biquads b0 b1 b2 a1 a2 on the reference", MAX_SECTIONS, 5
    ),
    _real("command_section", *_SECTION, "biquads b0 b1 b2 a1 a2 on the command", MAX_SECTIONS, 5),
)

_OBSERVER = (
    _real("observer_A", "1", *_GAIN, "state matrix, row-major", MAX_ORDER, MAX_ORDER),
    _real("observer_B", "1/V", *_GAIN, "input vector", MAX_ORDER),
    _real("observer_C", "m", *_GAIN, "output vector", MAX_ORDER),
    _real("observer_L", "1/m", *_GAIN, "correction of the states", MAX_ORDER),
    _real("observer_disturbance_L_V_per_m", "V/m", *_GAIN, "correction of the disturbance"),
    _real("observer_rest", "1/V", *_GAIN, "state at rest for 1 V", MAX_ORDER),
    _real("feedback_K_V", "V", *_GAIN, "state feedback", MAX_ORDER),
    _real("feedback_N_V_per_m", "V/m", *_GAIN, "reference gain"),
)

_TUNNELLING = (
    _real("current_reference_A", "A", 0, 1, "current whose logarithm is 0"),
    _real("current_floor_A", "A", 0, 1, "lowest current in the logarithm"),
    _real("current_ceiling_A", "A", 0, 1, "current at which the tip retracts at once"),
    _real("retract_voltage_V", *_V, "voltage at which a retract ends"),
    _real("retract_step_V", *_VOLTAGE_STEP, "length of a retract; 0: to retract_voltage_V"),
    _real("approach_step_V", *_VOLTAGE_STEP, "extension in a sample while there is no current"),
    _real("approach_log_step", *_LOG, "rise of the log of the reference per sample after contact"),
    _real("contact_log", *_LOG, "contact if ln(current) > ln(set point) - this"),
    _real("stuck_current_A", "A", -1, 1, "currents up to this are never stuck"),
    _real(
        "search_voltage_V", *_VOLTAGE_STEP, "search range beyond the last contact; 0: to the end"
    ),
    _real(
        "schedule_limit", "1", 1, 1e3, "tip axis: gain ratios stay in [1/limit, limit]", default=1
    ),
    _real("rst_T_V", "V", *_TAP, "T, on the reference", MAX_TAPS),
    _real("rst_R_V", "V", *_TAP, "R, on the measurement", MAX_TAPS),
    _real("rst_S", "1", *_TAP, "S without its integrator, monic", MAX_TAPS),
    _real("rst_A0", "1", *_TAP, "anti-windup polynomial, monic", MAX_TAPS),
)

PARAMETERS: tuple[Parameter, ...] = _HEADER + _COUNTS + _SIGNALS + _MODEL + _OBSERVER + _TUNNELLING

# Members that only the method ``rst`` uses.
TIP_PARAMETERS = frozenset(
    {
        *("bad_samples", "retract_samples", "contact_samples", "trip_limit", "trip_samples"),
        *(p.name for p in _COUNTS if p.name.startswith("rst_")),
        *(p.name for p in _TUNNELLING),
    }
)

INDEX: dict[str, int] = {p.name: number for number, p in enumerate(PARAMETERS, start=1)}


def structure(real: Any) -> type[ctypes.Structure]:
    """Return the mirror of ``pz_parameters``.

    real  ``ctypes.c_double`` or ``ctypes.c_float``
    """
    members: list[tuple[str, Any]] = []
    for parameter in PARAMETERS:
        member: Any = real if parameter.kind == "real" else ctypes.c_int32
        if parameter.name == "checksum":
            member = ctypes.c_uint32
        for extent in reversed(parameter.shape):
            member = member * extent
        members.append((parameter.name, member))
    return type("Parameters", (ctypes.Structure,), {"_fields_": members})
