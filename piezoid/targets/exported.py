"""What every target is made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.design.design import AxisDesign
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.identification.model import AxisModel
from piezoid.numerics.arrays import Array
from piezoid.targets.box import Box
from piezoid.verification.approach import Room, led_to
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.plant import AxisPlant
from piezoid.verification.scenarios import Path
from piezoid.verification.tracking import Tracking, track


@dataclass(frozen=True, kw_only=True, eq=False)
class Exported:
    """Of what targets are made.

    file     what ships
    plants   the identified plants of its axes, those that verification runs
    drawn    by axis, other plants that the recordings allow
    models   by axis, the identified model;  designs  the loops it was designed
    converter_V  ends of the stage's own converter, None where lab.toml does not say
    amplifier_V_per_V  by axis, where lab.toml says
    box      what the box can hold
    """

    file: ParameterFile
    plants: Sequence[AxisPlant] = ()
    drawn: Mapping[str, Sequence[AxisPlant]] = field(default_factory=dict)
    models: Mapping[str, AxisModel] = field(default_factory=dict)
    designs: Mapping[str, AxisDesign] = field(default_factory=dict)
    converter_V: tuple[float, float] | None = None
    amplifier_V_per_V: Mapping[str, float] = field(default_factory=dict)
    box: Box = field(default_factory=Box)

    @property
    def lateral(self) -> tuple[AxisParameters, ...]:
        """The axes that follow a displacement and of which everything is known."""
        return tuple(axis for axis in self.file.axes if axis.axis in self.models)

    def family(self, axis: str) -> tuple[AxisPlant, ...]:
        """Return the identified plant of an axis, and the others."""
        own = next(plant for plant in self.plants if plant.axis == axis)
        return (own, *self.drawn.get(axis, ()))


def tracked(
    path_m: Array, position_m: Array, room: Room, frequency_Hz: float, rate_Hz: float
) -> Tracking:
    """Compare one axis with its path, both about the middle."""
    return track(
        {"axis": path_m - room.centre_m},
        {"axis": position_m - room.centre_m},
        path=Path(x=path_m, y=path_m),
        radius_m=room.radius_m,
        frequency_Hz=frequency_Hz,
        sampling_rate_Hz=rate_Hz,
    )


def shipped_position_m(axis: AxisParameters, plant: AxisPlant, path_m: Array, seed: int) -> Array:
    """Return where the exported controller takes a plant that was led to its path."""
    led_m = led_to(plant, float(path_m[0]))
    whole_m = np.concatenate([led_m, path_m])
    rng = np.random.default_rng(seed)
    return run_axis(plant, axis, whole_m, rng=rng).position[len(led_m) :]
