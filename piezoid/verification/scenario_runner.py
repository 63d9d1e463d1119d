"""Where scenarios are run: parameters and plants by axis, and what was found so far."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.verification.closed_loop import LoopRecord, run_axis
from piezoid.verification.criteria import Limits, Verdict
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.plotted_paths import SpiralTrace
from piezoid.verification.start_position import approach_path, reference_range
from piezoid.verification.verification import ComparisonRow, CurrentRow, SpiralRow


@dataclass(frozen=True, kw_only=True, eq=False)
class Run:
    """What one axis is asked to follow, beside which disturbance and fault of its sensor."""

    axis: AxisParameters
    plant: AxisPlant
    reference: Array
    disturbance: Array | None = None
    fault: Array | None = None
    reset_at: int | None = None


@dataclass(kw_only=True, eq=False)
class ScenarioRunner:
    """Everything the runs share, and what they have found so far."""

    file: ParameterFile
    plants: Mapping[str, AxisPlant]
    limits: Limits
    seed: int
    rate_Hz: float
    lateral: tuple[str, ...]
    tunnelling: tuple[str, ...]
    centre_m: Mapping[str, float]
    radius_m: float
    executor: Executor = SERIAL
    runs: int = 0
    records: dict[str, list[LoopRecord]] = field(default_factory=dict)
    comparison: list[ComparisonRow] = field(default_factory=list)
    spirals: list[SpiralRow] = field(default_factory=list)
    currents: list[CurrentRow] = field(default_factory=list)
    traces: list[SpiralTrace] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    shown: dict[str, dict[str, LoopRecord]] = field(default_factory=dict)

    def methods(self) -> tuple[str, ...]:
        """Return the methods every lateral axis has, what ships first."""
        axes = [self.file.axis(name) for name in self.lateral]
        return tuple(m for m in axes[0].methods if all(m in axis.methods for axis in axes))

    def run(self, runs: Sequence[Run]) -> dict[str, LoopRecord]:
        """Run axes that move at the same time, each with noise of its own, and remember them."""
        numbered = list(enumerate(runs, self.runs + 1))
        self.runs += len(runs)
        records = self.executor.map(self._run, numbered)
        for record in records:
            self.records.setdefault(record.axis, []).append(record)
        return {record.axis: record for record in records}

    def _run(self, numbered: tuple[int, Run]) -> LoopRecord:
        number, run = numbered
        is_led = run.axis.axis in self.lateral
        way = approach_path(run.plant, float(run.reference[0])) if is_led else np.empty(0)
        led, asked = len(way), np.concatenate([way, run.reference])
        record = run_axis(
            run.plant,
            run.axis,
            asked,
            rng=np.random.default_rng([self.seed, number]),
            disturbance=_from_its_first(run.disturbance, led),
            fault=None if run.fault is None else np.concatenate([np.zeros(led), run.fault]),
            reset_at=None if run.reset_at is None else led + run.reset_at,
        )
        return record.after(led)


def _from_its_first(disturbance: Array | None, samples: int) -> Array | None:
    if disturbance is None:
        return None
    return np.concatenate([np.full(samples, disturbance[0]), disturbance])


def scenario_runner(
    file: ParameterFile,
    plants: Sequence[AxisPlant],
    limits: Limits,
    seed: int,
    executor: Executor = SERIAL,
) -> ScenarioRunner:
    """Put every axis beside its plant, and choose the radius of all paths.

    Raises ``ParameterFileError`` for an axis without a plant.
    """
    by_axis = {plant.axis: plant for plant in plants}
    for axis in file.axes:
        if axis.axis not in by_axis:
            raise ParameterFileError(
                f"axis {axis.axis} has parameters and no plant",
                needed="an identified plant for every axis that ships",
                remedy="Identify that axis, or leave it out of the parameter file.",
            )
    tips = tuple(a.axis for a in file.axes if isinstance(by_axis[a.axis].response, Junction))
    lateral = tuple(a.axis for a in file.axes if a.axis not in tips)
    rooms = {name: reference_range(file.axis(name)) for name in lateral}
    return ScenarioRunner(
        file=file,
        plants=by_axis,
        limits=limits,
        seed=seed,
        executor=executor,
        rate_Hz=by_axis[file.axes[0].axis].sampling_rate_Hz,
        lateral=lateral,
        tunnelling=tips,
        centre_m={name: room.centre_m for name, room in rooms.items()},
        radius_m=min((room.radius_m for room in rooms.values()), default=0.0),
    )
