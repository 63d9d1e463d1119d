"""A sampled unit as a zip for co-simulation: its description, sources and, where it can, a binary.

Entries carry a fixed date and the token is the digest of the contents, so the same sources and the
same compiler give the same bytes.

Sources: Functional Mock-up Interface Specification 2.0.4 and 3.0.1, Modelica Association.
"""

import io
import platform
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from piezoid.export.bundle import SAMPLES, shipped
from piezoid.export.c_header import c_header, inert
from piezoid.export.parameter_file import AxisParameters, ParameterFile, digest_of
from piezoid.export.shared_library import LINUX, shared_library
from piezoid.provenance import digest_of_bytes

_RUNTIME = ("piezoid_runtime.h", "piezoid_runtime.c", "fmu_controller.h")

_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest a zip knows


@dataclass(frozen=True, kw_only=True)
class Variable:
    """One variable of a unit; its value reference is its place among the unit's, from 1.

    causality    ``input``, ``output`` or ``parameter``
    unit         of a real; None: a whole number from 0 on
    start        before anything is set; None of an output
    """

    name: str
    causality: str
    description: str
    unit: str | None = None
    start: float | int | None = None


def variables(
    *rows: tuple[str, str, str | None, float | int | None, str],
) -> tuple[Variable, ...]:
    """Return the variables of a unit: name, causality, unit, start and description of each."""
    return tuple(
        Variable(name=name, causality=causality, unit=unit, start=start, description=description)
        for name, causality, unit, start, description in rows
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Unit:
    """What a unit is made of.

    identifier   a name in C
    description  a sentence
    header       of the sources: the ``FMU_UNIT`` of fmu.h
    macros       further lines of fmu_of_axis.h
    sources      beside those of the interface, name to bytes
    period_s     from one sample to the next
    samples      as many a simulator runs that is told nothing
    """

    identifier: str
    description: str
    header: str
    macros: str
    variables: tuple[Variable, ...]
    sources: Mapping[str, bytes]
    period_s: float
    samples: int


@dataclass(frozen=True, kw_only=True)
class _Interface:
    version: int
    binaries: Mapping[str, str]  # the machine's name to the folder of the standard

    @property
    def main(self) -> str:
        return f"fmu{self.version}.c"


_INTERFACES = (
    _Interface(version=2, binaries={"x86_64": "linux64"}),
    _Interface(version=3, binaries={"x86_64": "x86_64-linux", "aarch64": "aarch64-linux"}),
)

_AXIS = """\
/* Which unit this is, written by piezoid. */
#define FMU_UNIT "{header}"
#define FMU_TOKEN "{token}"
#define FMU_PREFIXED(name) {identifier}_##name
{macros}"""

_UNITS = """\
  <UnitDefinitions>
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="A"><BaseUnit A="1"/></Unit>
    <Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>
    <Unit name="1"><BaseUnit/></Unit>
  </UnitDefinitions>
"""

_HEAD = {
    2: """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{identifier}" guid="{token}"
    description="{description}" generationTool="piezoid" variableNamingConvention="flat"
    numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true">
    <SourceFiles><File name="fmu2.c"/></SourceFiles>
  </CoSimulation>
""",
    3: """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{identifier}" instantiationToken="{token}"
    description="{description}" generationTool="piezoid" variableNamingConvention="flat">
  <CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true"
      fixedInternalStepSize="{step}"/>
""",
}

_BUILD = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{identifier}">
    <SourceFileSet language="C99" compiler="gcc" compilerOptions="-O2 -ffp-contract=off">
      <SourceFile name="fmu3.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""


def packed(units: Mapping[str, Unit]) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the zips of units for both versions by file name, and what could not be made here.

    units  by the stem of their files' names
    """
    files: dict[str, bytes] = {}
    without: list[str] = []
    for stem, unit in units.items():
        for interface in _INTERFACES:
            name = f"{stem}_fmi{interface.version}.fmu"
            files[name], is_built = _packed(unit, interface)
            if not is_built:
                without.append(name)
    if not without:
        return files, ()
    said = (
        f"no binary inside fmu/{', fmu/'.join(without)}: no C compiler "
        f"({', '.join(LINUX.compilers)}; Debian's {LINUX.package}) for a Linux machine of a kind "
        "the standard names is here; the sources are inside, a simulator can compile them"
    )
    return files, (said,)


def _packed(unit: Unit, interface: _Interface) -> tuple[bytes, bool]:
    """Return one zip, and whether it has a binary."""
    sources = {name: shipped(name) for name in ("fmu.h", interface.main)} | dict(unit.sources)
    text = _description(unit, interface, "") + _axis(unit, "")
    token = digest_of_bytes(b"".join(sources[name] for name in sorted(sources)) + text.encode())
    sources["fmu_of_axis.h"] = _axis(unit, token).encode()
    contents = {"modelDescription.xml": _description(unit, interface, token).encode()}
    contents |= {f"sources/{name}": content for name, content in sources.items()}
    if interface.version == 3:
        built = _BUILD.format(identifier=unit.identifier)
        contents["sources/buildDescription.xml"] = built.encode()
    binary = _binary(sources, interface)
    if binary is not None:
        folder = interface.binaries[platform.machine()]
        contents[f"binaries/{folder}/{unit.identifier}.so"] = binary
    return _zipped(contents), binary is not None


def _axis(unit: Unit, token: str) -> str:
    return _AXIS.format(
        header=unit.header, token=token, identifier=unit.identifier, macros=unit.macros
    )


def _description(unit: Unit, interface: _Interface, token: str) -> str:
    head = _HEAD[interface.version].format(
        identifier=unit.identifier,
        description=unit.description,
        token=token,
        step=repr(unit.period_s),
    )
    stop_s, step_s = unit.samples * unit.period_s, unit.period_s
    described = _variables_2 if interface.version == 2 else _variables_3
    return (
        f"{head}{_UNITS}"
        f'  <DefaultExperiment startTime="0" stopTime="{stop_s!r}" stepSize="{step_s!r}"/>\n'
        f"{described(unit.variables)}</fmiModelDescription>\n"
    )


def _variables_2(variables: Iterable[Variable]) -> str:
    lines, outputs = ["  <ModelVariables>"], []
    for place, one in enumerate(variables, 1):
        kind = "Integer" if one.unit is None else f'Real unit="{one.unit}"'
        start = "" if one.start is None else f' start="{one.start!r}"'
        lines += [
            f'    <ScalarVariable name="{one.name}" valueReference="{place}" '
            f'causality="{one.causality}"',
            f'        variability="{_variability(one)}" description="{one.description}">',
            f"      <{kind}{start}/></ScalarVariable>",
        ]
        if one.causality == "output":
            outputs.append(f'<Unknown index="{place}"/>')
    return "\n".join([*lines, *_structure("Outputs", "InitialUnknowns", outputs)])


def _variables_3(variables: Iterable[Variable]) -> str:
    lines, outputs = ["  <ModelVariables>"], []
    lines += [
        '    <Float64 name="time" valueReference="0" causality="independent" '
        'variability="continuous"',
        '        unit="s"/>',
    ]
    for place, one in enumerate(variables, 1):
        kind = "UInt32" if one.unit is None else "Float64"
        unit = "" if one.unit is None else f' unit="{one.unit}"'
        start = "" if one.start is None else f' start="{one.start!r}"'
        lines += [
            f'    <{kind} name="{one.name}" valueReference="{place}" causality="{one.causality}"',
            f'        variability="{_variability(one)}"{unit}{start}',
            f'        description="{one.description}"/>',
        ]
        if one.causality == "output":
            outputs.append(f'valueReference="{place}"/>')
    known = [f"<Output {place}" for place in outputs]
    known += [f"<InitialUnknown {place}" for place in outputs]
    middle = "\n".join(f"    {line}" for line in known)
    structure = ["  </ModelVariables>", "  <ModelStructure>", middle, "  </ModelStructure>", ""]
    return "\n".join([*lines, *structure])


def _variability(one: Variable) -> str:
    return "fixed" if one.causality == "parameter" else "discrete"


def _structure(known: str, initial: str, outputs: Iterable[str]) -> tuple[str, ...]:
    inside = "".join(outputs)
    return (
        "  </ModelVariables>",
        "  <ModelStructure>",
        f"    <{known}>{inside}</{known}>",
        f"    <{initial}>{inside}</{initial}>",
        "  </ModelStructure>",
        "",
    )


def _binary(sources: Mapping[str, bytes], interface: _Interface) -> bytes | None:
    if platform.system() != "Linux" or platform.machine() not in interface.binaries:
        return None
    unprefixed = f"-DFMI{interface.version}_OVERRIDE_FUNCTION_PREFIX"
    return shared_library(sources, interface.main, LINUX, unprefixed)


def _zipped(contents: Mapping[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name in sorted(contents):
            entry = zipfile.ZipInfo(name, _DATE)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, contents[name], compresslevel=6)
    return stream.getvalue()


def controller_units(file: ParameterFile) -> Mapping[str, Unit]:
    """Return the units of all axes by the stem of their files' names."""
    sources = {name: shipped(name) for name in _RUNTIME}
    sources["piezo_params.h"] = c_header(file, digest_of(file)).encode()
    return {f"{axis.axis}_controller": _unit(file, axis, sources) for axis in file.axes}


def _unit(file: ParameterFile, axis: AxisParameters, sources: Mapping[str, bytes]) -> Unit:
    is_current = axis.method == "rst"
    unit = "A" if is_current else "m"
    start = float(axis.values["current_reference_A"]) if is_current else 0.0
    reading = "What the sensor shows; NaN where it shows nothing."
    status = "0, or the bits PZ_STATUS_... of sources/piezoid_runtime.h."
    begun = "What the converter puts out before the first sample."
    return Unit(
        identifier=f"piezoid_{axis.axis}_controller",
        description=f"Controller of axis {axis.axis}, method {axis.method}, "
        f"of the stage {inert(file.name)}",
        header="fmu_controller.h",
        macros=f"#define FMU_AXIS PIEZO_AXIS_{axis.axis.upper()}\n"
        f"#define FMU_INPUT_AT_START {start!r}\n",
        variables=variables(
            (f"reference_{unit}", "input", unit, start, "Wanted; NaN keeps the last one."),
            (f"measured_{unit}", "input", unit, start, reading),
            ("voltage_V", "output", "V", None, "To put out; always finite and inside the limits."),
            ("status", "output", None, None, status),
            ("start_voltage_V", "parameter", "V", 0.0, begun),
        ),
        sources=sources,
        period_s=1.0 / float(axis.values["sampling_rate_Hz"]),
        samples=SAMPLES,
    )
