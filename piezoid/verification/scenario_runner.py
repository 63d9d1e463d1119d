"""Run the axes of a parameter file along paths, and collect the results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import AxisParameters, ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL, Executor
from piezoid.verification.closed_loop import LoopRecord, run_axis
from piezoid.verification.criteria import Limits, Verdict
from piezoid.verification.plant import AxisPlant, Junction, with_histories
from piezoid.verification.plotted_paths import SpiralTrace
from piezoid.verification.scenarios import Path, Scenario
from piezoid.verification.start_position import approach_path, reference_range
from piezoid.verification.tracking import Tracking, track
from piezoid.verification.verification import ComparisonRow, CurrentRow, SpiralRow


@dataclass(frozen=True, kw_only=True, eq=False)
class AxisRun:
    """One axis, its plant and the signals that act on it, (samples,) each."""

    axis: AxisParameters
    plant: AxisPlant
    reference: Array
    disturbance: Array | None = None
    fault: Array | None = None
    reset_at: int | None = None


@dataclass(kw_only=True, eq=False)
class ScenarioRunner:
    """Parameters and plants by axis, and the results so far.

    lateral, tunnelling  names of the axes that follow a displacement, and that regulate a current
    centre_m, radius_m   of the paths
    run_count            runs so far; it numbers the noise
    records              all runs by axis
    single_runs          by scenario, runs of what ships that are not compared, for plots
    """

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
    run_count: int = 0
    records: dict[str, list[LoopRecord]] = field(default_factory=dict)
    comparison: list[ComparisonRow] = field(default_factory=list)
    spirals: list[SpiralRow] = field(default_factory=list)
    currents: list[CurrentRow] = field(default_factory=list)
    traces: list[SpiralTrace] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    single_runs: dict[str, dict[str, LoopRecord]] = field(default_factory=dict)

    def methods(self) -> tuple[str, ...]:
        """Return the methods that every lateral axis has; the first one ships."""
        axes = [self.file.axis(name) for name in self.lateral]
        return tuple(m for m in axes[0].methods if all(m in axis.methods for axis in axes))

    def histories(self) -> list[dict[str, AxisPlant]]:
        """Return all plants by axis with each possible history of the drive."""
        by_axis = {name: with_histories(plant) for name, plant in self.plants.items()}
        count = max(len(plants) for plants in by_axis.values())
        return [
            {name: plants[k % len(plants)] for name, plants in by_axis.items()}
            for k in range(count)
        ]

    def run(self, runs: Sequence[AxisRun]) -> dict[str, LoopRecord]:
        """Run axes that move at the same time, each with its own noise, and store the records."""
        numbered = list(enumerate(runs, self.run_count + 1))
        self.run_count += len(runs)
        records = self.executor.map(self._run, numbered)
        for record in records:
            self.records.setdefault(record.axis, []).append(record)
        return {record.axis: record for record in records}

    def run_path(
        self,
        path: Path,
        method: str | None = None,
        plants: Mapping[str, AxisPlant] | None = None,
        fault: Array | None = None,
    ) -> dict[str, LoopRecord]:
        """Run all lateral axes along a path: the first follows x, the second y, and so on.

        Args:
            path: unit path
            method: of the controller; None: the one that ships
            plants: by axis; None: the identified ones
            fault: of the sensors, (samples,)
        """
        signals = (path.x, path.y)
        runs = []
        for index, name in enumerate(self.lateral):
            axis, plant = self.file.axis(name), (plants or self.plants)[name]
            motion_m = None
            if plant.motions:  # some of which follow the other axis
                motion_m = plant.motion_m(len(path.x), signals[(index + 1) % 2])
            runs.append(
                AxisRun(
                    axis=axis if method is None else axis.for_method(method),
                    plant=plant,
                    reference=self.centre_m[name] + self.radius_m * signals[index % 2],
                    disturbance=motion_m,
                    fault=fault,
                )
            )
        return self.run(runs)

    def track(self, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]) -> Tracking:
        """Compare records with the path, about its centre."""
        return track(
            {name: r.reference - self.centre_m[name] for name, r in records.items()},
            {name: r.position - self.centre_m[name] for name, r in records.items()},
            path=path,
            radius_m=self.radius_m,
            frequency_Hz=scenario.frequency_Hz,
            sampling_rate_Hz=self.rate_Hz,
        )

    def _run(self, numbered: tuple[int, AxisRun]) -> LoopRecord:
        number, run = numbered
        approach = np.empty(0)
        if run.axis.axis in self.lateral:
            approach = approach_path(run.plant, float(run.reference[0]))
        lead = len(approach)
        disturbance, fault = run.disturbance, run.fault
        if disturbance is not None:
            disturbance = np.concatenate([np.full(lead, disturbance[0]), disturbance])
        if fault is not None:
            fault = np.concatenate([np.zeros(lead), fault])
        record = run_axis(
            run.plant,
            run.axis,
            np.concatenate([approach, run.reference]),
            rng=np.random.default_rng([self.seed, number]),
            disturbance=disturbance,
            fault=fault,
            reset_at=None if run.reset_at is None else lead + run.reset_at,
        )
        return record.after(lead)


def scenario_runner(
    file: ParameterFile,
    plants: Sequence[AxisPlant],
    limits: Limits,
    seed: int,
    executor: Executor = SERIAL,
) -> ScenarioRunner:
    """Pair every axis with its plant, and choose the radius of all paths.

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
    ranges = {name: reference_range(file.axis(name)) for name in lateral}
    return ScenarioRunner(
        file=file,
        plants=by_axis,
        limits=limits,
        seed=seed,
        executor=executor,
        rate_Hz=by_axis[file.axes[0].axis].sampling_rate_Hz,
        lateral=lateral,
        tunnelling=tips,
        centre_m={name: span.centre_m for name, span in ranges.items()},
        radius_m=min((span.radius_m for span in ranges.values()), default=0.0),
    )
