"""The target `fmu`: co-simulation units of controllers and of the identified plants, FMI 2.0.

A unit is a zip file with a description, C sources and, where a compiler is installed, a binary.
Zip entries carry a fixed date and the guid is a digest of the contents, so the same sources and
the same compiler give the same bytes.

plant_of_axis.h contains an identified plant at rest, as constants of the structure of
plant_loop.c. The numbers are read from the structure that verification uses, so that there is one
forward model. They are printed as the shortest decimals that read as the same doubles.

Source: Functional Mock-up Interface Specification 2.0.4, Modelica Association.
"""

import ctypes
import io
import platform
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.resources import files

import numpy as np

from piezoid.digests import digest_of_bytes
from piezoid.export.bundle import SAMPLES, runtime_source
from piezoid.export.c_header import c_header, plain_ascii
from piezoid.export.parameter_file import ParameterFile, digest_of
from piezoid.targets.library import LINUX, shared_library
from piezoid.verification.loop_plant import SettledPlant
from piezoid.verification.plant import AxisPlant, Junction

_RUNTIME_SOURCES = ("piezoid_runtime.h", "piezoid_runtime.c", "fmu_controller.h")
_MAIN = "fmu2.c"
_EARLIEST_DATE = (1980, 1, 1, 0, 0, 0)  # of the zip format


Variable = tuple[str, str, str | None, float | int | None, str]
"""Name of a variable of a unit, its causality, unit, initial value and description.

The causality is ``input``, ``output`` or ``parameter``. An integer has no unit, and an output has
no initial value.
"""


@dataclass(frozen=True, kw_only=True, eq=False)
class Unit:
    """Contents of one unit.

    identifier   model identifier, a C name
    description  one sentence
    header       the header that ``fmu2.c`` includes as ``FMU_UNIT``
    macros       additional lines of ``fmu_of_axis.h``
    sources      contents of the C sources other than ``fmu2.c``, by name
    period_s     sampling period
    variables    their value references are their indices, from 1
    """

    identifier: str
    description: str
    header: str
    macros: str
    variables: tuple[Variable, ...]
    sources: Mapping[str, bytes]
    period_s: float


_AXIS_HEADER = """\
/* Which unit this is, written by piezoid. */
#define FMU_UNIT "{header}"
#define FMU_TOKEN "{token}"
#define FMU_PREFIXED(name) {identifier}_##name
{macros}"""

_DESCRIPTION = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{identifier}" guid="{token}"
    description="{description}" generationTool="piezoid" variableNamingConvention="flat"
    numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true">
    <SourceFiles><File name="fmu2.c"/></SourceFiles>
  </CoSimulation>
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="A"><BaseUnit A="1"/></Unit>
    <Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>
    <Unit name="1"><BaseUnit/></Unit>
  </UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="{stop_s!r}" stepSize="{step_s!r}"/>
  <ModelVariables>
{variables}
  </ModelVariables>
  <ModelStructure>
    <Outputs>{outputs}</Outputs>
    <InitialUnknowns>{outputs}</InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
"""

_VARIABLE = """\
    <ScalarVariable name="{name}" valueReference="{index}" causality="{causality}"
        variability="{variability}" description="{description}">
      <{type}{start}/></ScalarVariable>"""


def fmu_files(units: Mapping[str, Unit]) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the zip files of units by name, and a note about binaries that could not be built.

    Args:
        units: contents by the stem of the file's name
    """
    files: dict[str, bytes] = {}
    without_binary: list[str] = []
    for stem, unit in units.items():
        name = f"{stem}_fmi2.fmu"
        sources = {_MAIN: runtime_source(_MAIN)} | dict(unit.sources)
        axis_header = partial(
            _AXIS_HEADER.format,
            header=unit.header,
            identifier=unit.identifier,
            macros=unit.macros,
        )
        text = _description(unit, "") + axis_header(token="")
        joined = b"".join(sources[source] for source in sorted(sources))
        token = digest_of_bytes(joined + text.encode())
        sources["fmu_of_axis.h"] = axis_header(token=token).encode()
        contents = {"modelDescription.xml": _description(unit, token).encode()}
        contents |= {f"sources/{source}": content for source, content in sources.items()}
        binary = None
        if (platform.system(), platform.machine()) == ("Linux", "x86_64"):
            binary = shared_library(sources, _MAIN, LINUX, "-DFMI2_OVERRIDE_FUNCTION_PREFIX")
        if binary is None:
            without_binary.append(name)
        else:
            contents[f"binaries/linux64/{unit.identifier}.so"] = binary
        stream = io.BytesIO()
        with zipfile.ZipFile(stream, "w") as archive:
            for entry_name in sorted(contents):
                entry = zipfile.ZipInfo(entry_name, _EARLIEST_DATE)
                entry.compress_type = zipfile.ZIP_DEFLATED
                entry.external_attr = 0o644 << 16
                archive.writestr(entry, contents[entry_name], compresslevel=6)
        files[name] = stream.getvalue()
    if not without_binary:
        return files, ()
    note = (
        f"no binary inside fmu/{', fmu/'.join(without_binary)}: no C compiler "
        f"({', '.join(LINUX.compilers)}; Debian's {LINUX.package}) for 64-bit Linux on a PC was "
        "found. The sources are inside; a simulator can compile them"
    )
    return files, (note,)


def _description(unit: Unit, token: str) -> str:
    """Return the text of modelDescription.xml."""
    described = [
        _VARIABLE.format(
            name=name,
            index=index,
            causality=causality,
            variability="fixed" if causality == "parameter" else "discrete",
            description=description,
            type="Integer" if si_unit is None else f'Real unit="{si_unit}"',
            start="" if start is None else f' start="{start!r}"',
        )
        for index, (name, causality, si_unit, start, description) in enumerate(unit.variables, 1)
    ]
    outputs = [
        f'<Unknown index="{index}"/>'
        for index, (_, causality, *_) in enumerate(unit.variables, 1)
        if causality == "output"
    ]
    return _DESCRIPTION.format(
        identifier=unit.identifier,
        description=unit.description,
        token=token,
        stop_s=SAMPLES * unit.period_s,
        step_s=unit.period_s,
        variables="\n".join(described),
        outputs="".join(outputs),
    )


def controller_units(file: ParameterFile) -> Mapping[str, Unit]:
    """Return the controller units of all axes by the stem of their file names."""
    sources = {name: runtime_source(name) for name in _RUNTIME_SOURCES}
    sources["piezo_params.h"] = c_header(file, digest_of(file)).encode()
    reference = "Reference; NaN keeps the previous value."
    reading = "Sensor reading; NaN if there is none."
    voltage = "Command; always finite and inside the limits."
    status = "0, or the bits PZ_STATUS_... of sources/piezoid_runtime.h."
    start_voltage = "Output of the converter before the first sample."
    units = {}
    for axis in file.axes:
        unit, start = "m", 0.0
        if axis.is_tip:
            unit, start = "A", float(axis.values["current_reference_A"])
        units[f"{axis.axis}_controller"] = Unit(
            identifier=f"piezoid_{axis.axis}_controller",
            description=f"Controller of axis {axis.axis}, method {axis.method}, "
            f"of the stage {plain_ascii(file.name)}",
            header="fmu_controller.h",
            macros=f"#define FMU_AXIS PIEZO_AXIS_{axis.axis.upper()}\n"
            f"#define FMU_INPUT_AT_START {start!r}\n",
            variables=(
                (f"reference_{unit}", "input", unit, start, reference),
                (f"measured_{unit}", "input", unit, start, reading),
                ("voltage_V", "output", "V", None, voltage),
                ("status", "output", None, None, status),
                ("start_voltage_V", "parameter", "V", 0.0, start_voltage),
            ),
            sources=sources,
            period_s=1.0 / axis.sampling_rate_Hz,
        )
    return units


# Arrays of the state, of which fmu_plant.h gives every instance its own copy.
_STATES = frozenset({"late_V", "play_V", "second_play_V", "before_x", "after_x"})
_PLANT_SOURCES = ("fmu_plant.h", "plant_loop.c")


def plant_units(name: str, plants: Sequence[AxisPlant]) -> Mapping[str, Unit]:
    """Return the units of identified plants by the stem of their files' names.

    name  of the stage
    """
    package = files("piezoid.verification")
    sources = {source: package.joinpath(source).read_bytes() for source in _PLANT_SOURCES}
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
    lines += [f"#define PLANT_{name} {_c_number(value)}" for name, value in macros.items()]
    arrays = settled.arrays
    states = initial.after.states
    driven = arrays["after_B_old"] + arrays["after_B_new"]
    transition = np.eye(states) - arrays["after_A"]
    arrays["after_settled"] = np.asarray(np.linalg.solve(transition, driven), dtype=np.float64)
    arrays["hum_Hz"] = np.array([frequency_Hz for frequency_Hz, _ in plant.hums])
    arrays["hum"] = np.array([amplitude for _, amplitude in plant.hums])
    initialiser, pointers = _initialiser(initial)
    for name in (*pointers, "after_settled", "hum_Hz", "hum"):
        numbers = ", ".join(map(_c_number, arrays.get(name, np.zeros(0)).ravel())) or "0.0"
        lines.append(f"static const double plant_{name}[] = {{{numbers}}};")
    return "\n".join([*lines, f"static const pl_plant plant_at_rest = {initialiser};", ""])


def _initialiser(structure: ctypes.Structure, prefix: str = "") -> tuple[str, list[str]]:
    """Return the C initialiser of a structure, and the names of the arrays it refers to."""
    members, pointers = [], list[str]()
    for name, kind, *_ in structure._fields_:
        value = getattr(structure, name)
        if kind is ctypes.c_void_p:
            pointers.append(prefix + name)
            if pointers[-1] not in _STATES:
                members.append(f".{name} = plant_{pointers[-1]}")
        elif isinstance(value, ctypes.Structure):
            text, inner = _initialiser(value, f"{name}_")
            pointers += inner
            members.append(f".{name} = {text}")
        elif isinstance(value, ctypes.Array):
            members.append(f".{name} = {{{', '.join(map(_c_number, value))}}}")
        elif isinstance(value, int | float):  # not a function
            members.append(f".{name} = {_c_number(value)}")
    lines = "".join(f"    {member},\n" for member in members)
    return f"{{\n{lines}}}", pointers


def _c_number(value: float) -> str:
    if isinstance(value, float) and np.isinf(value):
        return "HUGE_VAL" if value > 0 else "-HUGE_VAL"
    return repr(int(value)) if isinstance(value, int) else repr(float(value))
