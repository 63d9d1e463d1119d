"""The target `fmu`: each axis' controller as co-simulation units of FMI 2.0 and 3.0.

One unit is a zip of modelDescription.xml, the sources (the one runtime, wrapped) and, where a C
compiler is here, a binary for Linux. Entries carry a fixed date and the token is the digest of the
contents, so the same parameters and the same compiler give the same bytes.

Sources: Functional Mock-up Interface Specification 2.0.4 and 3.0.1, Modelica Association.
"""

import io
import platform
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass

from piezoid.export.bundle import shipped
from piezoid.export.c_header import c_header
from piezoid.export.compiled import LINUX, shared_library
from piezoid.export.inert import inert
from piezoid.export.parameter_file import AxisParameters, ParameterFile, digest_of
from piezoid.provenance import digest_of_bytes

_DATE = (1980, 1, 1, 0, 0, 0)  # the earliest a zip knows
_RUNTIME = ("piezoid_runtime.h", "piezoid_runtime.c", "fmu.h")


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
/* Which axis the unit is, written by piezoid. */
#define FMU_AXIS PIEZO_AXIS_{upper}
#define FMU_TOKEN "{token}"
#define FMU_PREFIXED(name) {identifier}_##name
#define FMU_INPUT_AT_START {start}
"""

_UNITS = """\
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="A"><BaseUnit A="1"/></Unit>
    <Unit name="V"><BaseUnit kg="1" m="2" s="-3" A="-1"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>"""

_REFERENCE = "Wanted; NaN keeps the last one."
_MEASURED = "What the sensor shows; NaN where it shows nothing."
_VOLTAGE = "To put out; always finite and inside the limits."
_STATUS = "0, or the bits PZ_STATUS_... of sources/piezoid_runtime.h."
_START = "What the converter puts out before the first sample."

_XML = {
    2: """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="2.0" modelName="{identifier}" guid="{token}"
    description="{description}" generationTool="piezoid" variableNamingConvention="flat"
    numberOfEventIndicators="0">
  <CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true">
    <SourceFiles><File name="fmu2.c"/></SourceFiles>
  </CoSimulation>
  <UnitDefinitions>
{units}
  </UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="{stop}" stepSize="{step}"/>
  <ModelVariables>
    <ScalarVariable name="reference_{unit}" valueReference="1" causality="input"
        variability="discrete" description="{reference}">
      <Real unit="{unit}" start="{start}"/></ScalarVariable>
    <ScalarVariable name="measured_{unit}" valueReference="2" causality="input"
        variability="discrete" description="{measured}">
      <Real unit="{unit}" start="{start}"/></ScalarVariable>
    <ScalarVariable name="voltage_V" valueReference="3" causality="output"
        variability="discrete" description="{voltage}"><Real unit="V"/></ScalarVariable>
    <ScalarVariable name="status" valueReference="4" causality="output"
        variability="discrete" description="{status}"><Integer/></ScalarVariable>
    <ScalarVariable name="start_voltage_V" valueReference="5" causality="parameter"
        variability="fixed" description="{start_voltage}">
      <Real unit="V" start="0"/></ScalarVariable>
  </ModelVariables>
  <ModelStructure>
    <Outputs><Unknown index="3"/><Unknown index="4"/></Outputs>
    <InitialUnknowns><Unknown index="3"/><Unknown index="4"/></InitialUnknowns>
  </ModelStructure>
</fmiModelDescription>
""",
    3: """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{identifier}" instantiationToken="{token}"
    description="{description}" generationTool="piezoid" variableNamingConvention="flat">
  <CoSimulation modelIdentifier="{identifier}" canHandleVariableCommunicationStepSize="true"
      fixedInternalStepSize="{step}"/>
  <UnitDefinitions>
{units}
  </UnitDefinitions>
  <DefaultExperiment startTime="0" stopTime="{stop}" stepSize="{step}"/>
  <ModelVariables>
    <Float64 name="time" valueReference="0" causality="independent" variability="continuous"
        unit="s"/>
    <Float64 name="reference_{unit}" valueReference="1" causality="input" variability="discrete"
        unit="{unit}" start="{start}" description="{reference}"/>
    <Float64 name="measured_{unit}" valueReference="2" causality="input" variability="discrete"
        unit="{unit}" start="{start}" description="{measured}"/>
    <Float64 name="voltage_V" valueReference="3" causality="output" variability="discrete"
        unit="V" description="{voltage}"/>
    <UInt32 name="status" valueReference="4" causality="output" variability="discrete"
        description="{status}"/>
    <Float64 name="start_voltage_V" valueReference="5" causality="parameter" variability="fixed"
        unit="V" start="0" description="{start_voltage}"/>
  </ModelVariables>
  <ModelStructure>
    <Output valueReference="3"/><Output valueReference="4"/>
    <InitialUnknown valueReference="3"/><InitialUnknown valueReference="4"/>
  </ModelStructure>
</fmiModelDescription>
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


def fmus(file: ParameterFile) -> tuple[Mapping[str, bytes], tuple[str, ...]]:
    """Return the units of all axes by file name, and what could not be made on this machine."""
    header = c_header(file, digest_of(file)).encode()
    files: dict[str, bytes] = {}
    without: list[str] = []
    for axis in file.axes:
        for interface in _INTERFACES:
            name = f"{axis.axis}_controller_fmi{interface.version}.fmu"
            files[name], is_built = _unit(file, axis, header, interface)
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


def _unit(
    file: ParameterFile, axis: AxisParameters, header: bytes, interface: _Interface
) -> tuple[bytes, bool]:
    """Return one unit, and whether it has a binary."""
    sources = {name: shipped(name) for name in (*_RUNTIME, interface.main)}
    sources["piezo_params.h"] = header
    given = _given(file, axis)
    xml = _XML[interface.version]
    text = xml.format(token="", **given) + _AXIS.format(token="", **given)
    token = digest_of_bytes(b"".join(sources[name] for name in sorted(sources)) + text.encode())
    sources["fmu_of_axis.h"] = _AXIS.format(token=token, **given).encode()
    contents = {"modelDescription.xml": xml.format(token=token, **given).encode()}
    contents |= {f"sources/{name}": content for name, content in sources.items()}
    if interface.version == 3:
        contents["sources/buildDescription.xml"] = _BUILD.format(**given).encode()
    binary = _binary(sources, interface)
    if binary is not None:
        folder = interface.binaries[platform.machine()]
        contents[f"binaries/{folder}/{given['identifier']}.so"] = binary
    return _zipped(contents), binary is not None


def _given(file: ParameterFile, axis: AxisParameters) -> dict[str, str]:
    is_current = axis.method == "rst"
    period_s = 1.0 / float(axis.values["sampling_rate_Hz"])
    start = float(axis.values["current_reference_A"]) if is_current else 0.0
    return {
        "identifier": f"piezoid_{axis.axis}_controller",
        "upper": axis.axis.upper(),
        "description": f"Controller of axis {axis.axis}, method {axis.method}, "
        f"of the stage {inert(file.name)}",
        "units": _UNITS,
        "unit": "A" if is_current else "m",
        "start": repr(start),
        "step": repr(period_s),
        "stop": repr(1000 * period_s),  # as many samples as golden.csv has
        "reference": _REFERENCE,
        "measured": _MEASURED,
        "voltage": _VOLTAGE,
        "status": _STATUS,
        "start_voltage": _START,
    }


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
