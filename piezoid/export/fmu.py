"""Each axis' controller as a unit for co-simulation: the one runtime, wrapped."""

from collections.abc import Mapping

from piezoid.export.bundle import shipped
from piezoid.export.c_header import c_header
from piezoid.export.fmu_unit import Unit, Variable
from piezoid.export.golden import SAMPLES
from piezoid.export.inert import inert
from piezoid.export.parameter_file import AxisParameters, ParameterFile, digest_of

_RUNTIME = ("piezoid_runtime.h", "piezoid_runtime.c", "fmu_controller.h")


def controller_units(file: ParameterFile) -> Mapping[str, Unit]:
    """Return the units of all axes by the stem of their files' names."""
    sources = {name: shipped(name) for name in _RUNTIME}
    sources["piezo_params.h"] = c_header(file, digest_of(file)).encode()
    return {f"{axis.axis}_controller": _unit(file, axis, sources) for axis in file.axes}


def _unit(file: ParameterFile, axis: AxisParameters, sources: Mapping[str, bytes]) -> Unit:
    is_current = axis.method == "rst"
    unit = "A" if is_current else "m"
    start = float(axis.values["current_reference_A"]) if is_current else 0.0
    return Unit(
        identifier=f"piezoid_{axis.axis}_controller",
        description=f"Controller of axis {axis.axis}, method {axis.method}, "
        f"of the stage {inert(file.name)}",
        header="fmu_controller.h",
        macros=f"#define FMU_AXIS PIEZO_AXIS_{axis.axis.upper()}\n"
        f"#define FMU_INPUT_AT_START {start!r}\n",
        variables=(
            Variable(
                name=f"reference_{unit}",
                causality="input",
                unit=unit,
                start=start,
                description="Wanted; NaN keeps the last one.",
            ),
            Variable(
                name=f"measured_{unit}",
                causality="input",
                unit=unit,
                start=start,
                description="What the sensor shows; NaN where it shows nothing.",
            ),
            Variable(
                name="voltage_V",
                causality="output",
                unit="V",
                description="To put out; always finite and inside the limits.",
            ),
            Variable(
                name="status",
                causality="output",
                description="0, or the bits PZ_STATUS_... of sources/piezoid_runtime.h.",
            ),
            Variable(
                name="start_voltage_V",
                causality="parameter",
                unit="V",
                start=0.0,
                description="What the converter puts out before the first sample.",
            ),
        ),
        sources=sources,
        period_s=1.0 / float(axis.values["sampling_rate_Hz"]),
        samples=SAMPLES,
    )
