"""Inputs of the targets, and the comparison of a target with the exported controller."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.formatting import with_unit
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.targets.controller_hardware import ControllerHardware
from piezoid.verification.closed_loop import approach_path, run_axis
from piezoid.verification.plant import AxisPlant

SEED = 0  # of the sensor noise in every comparison

Errors = Mapping[str, Mapping[str, float]]
"""Errors in m by plant and by column of the table in README.md."""


@dataclass(frozen=True, kw_only=True, eq=False)
class TargetInputs:
    """Exported controller, identified plants and hardware limits.

    file         exported parameters
    plants       identified plants of the axes, as in verification
    drawn        other plants that the recordings allow, by axis
    models       identified models, by axis
    designs      designed loops, by axis
    converter_V  range of the stage's converter; None: not declared in lab.toml
    amplifier_V_per_V  gains that lab.toml declares, by axis
    hardware     limits of the hardware for which targets are made
    """

    file: ParameterFile
    plants: Sequence[AxisPlant] = ()
    drawn: Mapping[str, Sequence[AxisPlant]] = field(default_factory=dict)
    models: Mapping[str, AxisModel] = field(default_factory=dict)
    designs: Mapping[str, AxisDesign] = field(default_factory=dict)
    converter_V: tuple[float, float] | None = None
    amplifier_V_per_V: Mapping[str, float] = field(default_factory=dict)
    hardware: ControllerHardware = field(default_factory=ControllerHardware)

    @property
    def lateral(self) -> tuple[AxisParameters, ...]:
        """Axes that control a displacement and have an identified model."""
        return tuple(axis for axis in self.file.axes if axis.axis in self.models)

    @property
    def tips(self) -> tuple[str, ...]:
        """Names of the axes that regulate a current."""
        return tuple(axis.axis for axis in self.file.axes if axis.method == "rst")

    def family(self, axis: str) -> tuple[AxisPlant, ...]:
        """Return the identified plant of an axis, then other plants that the recordings allow."""
        identified = next(plant for plant in self.plants if plant.axis == axis)
        return (identified, *self.drawn.get(axis, ()))


def exported_position_m(axis: AxisParameters, plant: AxisPlant, path_m: Array) -> Array:
    """Simulate the exported controller along a path; return the position, (samples,)."""
    approach_m = approach_path(plant, float(path_m[0]))
    reference_m = np.concatenate([approach_m, path_m])
    record = run_axis(plant, axis, reference_m, rng=np.random.default_rng(SEED))
    return record.position[len(approach_m) :]


def worst_errors(errors_m: Errors) -> dict[str, str]:
    """Return the largest error of each column, formatted."""
    columns = next(iter(errors_m.values()))
    return {name: with_unit(max(row[name] for row in errors_m.values()), "m") for name in columns}


def error_rows(errors_m: Errors) -> str:
    """Return the rows of a Markdown table: a plant and its errors."""
    return "\n".join(
        f"| {plant} | {' | '.join(with_unit(error_m, 'm') for error_m in row.values())} |"
        for plant, row in errors_m.items()
    )
