"""The target `fmu`: each axis' controller, and the identified plant that verification runs.

Sources: Functional Mock-up Interface Specification 2.0.4 and 3.0.1, Modelica Association.
"""

from collections.abc import Mapping, Sequence
from importlib.resources import files

from piezoid.export.fmu_unit import Unit, Variable
from piezoid.export.golden import SAMPLES
from piezoid.export.inert import inert
from piezoid.targets.plant_header import plant_header
from piezoid.verification.plant import AxisPlant, Junction

_SOURCES = ("fmu_plant.h", "plant_loop.c")


def plant_units(name: str, plants: Sequence[AxisPlant]) -> Mapping[str, Unit]:
    """Return the units of identified plants by the stem of their files' names.

    name  of the stage
    """
    return {f"{plant.axis}_plant": _unit(name, plant) for plant in plants}


def _unit(name: str, plant: AxisPlant) -> Unit:
    is_tip = isinstance(plant.response, Junction)
    unit = "A" if is_tip else "m"
    place = files("piezoid.verification")
    sources = {source: place.joinpath(source).read_bytes() for source in _SOURCES}
    sources["plant_of_axis.h"] = plant_header(plant).encode()
    moved = Variable(
        name="withdrawn_m" if is_tip else "disturbance_m",
        causality="input",
        unit="m",
        start=0.0,
        description="How far the surface is below where it was at rest"
        if is_tip
        else "What moves the stage beside its drive",
    )
    said = f"{moved.description}, at the end of the period; reached in a straight line."
    variables = (
        Variable(
            name="voltage_V",
            causality="input",
            unit="V",
            start=plant.rest_voltage_V,
            description="The command, held for a period.",
        ),
        Variable(
            name=moved.name,
            causality=moved.causality,
            unit=moved.unit,
            start=moved.start,
            description=said,
        ),
        Variable(
            name=f"measured_{unit}",
            causality="output",
            unit=unit,
            description="What the sensor shows at the sampling instant, noise and rounding in it.",
        ),
        Variable(
            name=f"position_{unit}",
            causality="output",
            unit=unit,
            description="In front of the sensor at that instant.",
        ),
        Variable(
            name="noise_factor",
            causality="parameter",
            unit="1",
            start=1.0,
            description="Of the identified noise and lines in the reading; 0: none.",
        ),
        Variable(
            name="noise_seed",
            causality="parameter",
            start=0,
            description="Of the noise: the same seed, the same noise.",
        ),
    )
    return Unit(
        identifier=f"piezoid_{plant.axis}_plant",
        description=f"Identified plant of axis {plant.axis} of the stage {inert(name)}, "
        f"at rest at {plant.rest_voltage_V!r} V",
        header="fmu_plant.h",
        macros="",
        variables=variables,
        sources=sources,
        period_s=1.0 / plant.sampling_rate_Hz,
        samples=SAMPLES,
    )
