"""Simulate the axes of a parameter file along paths, and collect the results."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import ParameterFile
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import Executor
from piezoid.verification.closed_loop import reference_range, run_axis
from piezoid.verification.criteria import Limits, Verdict
from piezoid.verification.plant import AxisPlant, Hysteresis, Junction
from piezoid.verification.scenarios import Path, Scenario
from piezoid.verification.tracking import LoopRecord, SpiralTrace, Tracking, track
from piezoid.verification.verification import ComparisonRow, CurrentRow, SpiralRow


@dataclass(kw_only=True, eq=False)
class ScenarioRunner:
    """Parameters and plants by axis, and the accumulated results.

    plants               identified, by axis
    run_count            number of runs, from which the seed of the noise follows
    outside_voltages     samples of all runs whose voltage was not finite or outside the limits
    lateral, tunnelling  names of the axes that control a displacement, and a current
    centre_m, radius_m   of the paths

    Raises ``ParameterFileError`` for an axis without a plant.
    """

    file: ParameterFile
    plants: Mapping[str, AxisPlant]
    limits: Limits
    seed: int
    executor: Executor
    run_count: int = 0
    outside_voltages: int = 0
    comparison: list[ComparisonRow] = field(default_factory=list)
    spirals: list[SpiralRow] = field(default_factory=list)
    currents: list[CurrentRow] = field(default_factory=list)
    traces: list[SpiralTrace] = field(default_factory=list)
    verdicts: list[Verdict] = field(default_factory=list)
    rate_Hz: float = field(init=False)
    lateral: tuple[str, ...] = field(init=False)
    tunnelling: tuple[str, ...] = field(init=False)
    centre_m: Mapping[str, float] = field(init=False)
    radius_m: float = field(init=False)

    def __post_init__(self) -> None:
        axes = [axis.axis for axis in self.file.axes]
        for axis in axes:
            if axis not in self.plants:
                raise ParameterFileError(
                    f"axis {axis} has parameters and no plant",
                    needed="an identified plant for every axis that ships",
                    remedy="Identify that axis, or leave it out of the parameter file.",
                )
        self.rate_Hz = self.plants[axes[0]].sampling_rate_Hz
        self.tunnelling = tuple(a for a in axes if isinstance(self.plants[a].response, Junction))
        self.lateral = tuple(a for a in axes if a not in self.tunnelling)
        ranges = {name: reference_range(self.file.axis(name)) for name in self.lateral}
        self.centre_m = {name: span.centre_m for name, span in ranges.items()}
        self.radius_m = min((span.radius_m for span in ranges.values()), default=0.0)

    def methods(self) -> tuple[str, ...]:
        """Return the methods that every lateral axis has, the shipped method first."""
        first, *remaining = [self.file.axis(name).methods for name in self.lateral]
        return tuple(m for m in first if all(m in methods for methods in remaining))

    def histories(self) -> list[dict[str, AxisPlant]]:
        """Return all plants by axis with each possible history of the drive."""
        by_axis: dict[str, list[AxisPlant]] = {}
        for name, plant in self.plants.items():
            response, by_axis[name] = plant.response, [plant]
            if isinstance(response, Hysteresis) and response.histories_V:
                by_axis[name] = [
                    replace(plant, response=replace(response, history_V=history_V))
                    for history_V in response.histories_V
                ]
        count = max(len(plants) for plants in by_axis.values())
        return [
            {name: plants[k % len(plants)] for name, plants in by_axis.items()}
            for k in range(count)
        ]

    def run(self, runs: Sequence[partial[LoopRecord]]) -> dict[str, LoopRecord]:
        """Simulate axes, each with independent noise; return their records by axis.

        runs  ``run_axis`` with a plant, parameters and all other arguments except ``rng``
        """
        numbers = range(self.run_count + 1, self.run_count + 1 + len(runs))
        generators = [np.random.default_rng([self.seed, number]) for number in numbers]
        self.run_count += len(runs)
        jobs = list(zip(runs, generators, strict=True))
        records = self.executor.map(lambda job: job[0](rng=job[1]), jobs)
        for run, record in zip(runs, records, strict=True):
            _, parameters, *_ = run.args
            low_V, high_V = parameters.voltage_range_V
            is_inside = (record.voltage_V >= low_V) & (record.voltage_V <= high_V)
            self.outside_voltages += int(np.sum(~(np.isfinite(record.voltage_V) & is_inside)))
        return {record.axis: record for record in records}

    def run_path(
        self,
        path: Path,
        method: str | None = None,
        plants: Mapping[str, AxisPlant] | None = None,
        fault: Array | None = None,
    ) -> dict[str, LoopRecord]:
        """Simulate all lateral axes along a path; they follow x and y alternately.

        path    of radius 1
        method  of the controller; None: the shipped method
        plants  by axis; None: the identified plants
        fault   (samples,)  of all sensors
        """
        signals, runs = (path.x, path.y), []
        for index, name in enumerate(self.lateral):
            axis, plant = self.file.axis(name), (plants or self.plants)[name]
            motion_m = plant.motion_m(len(path.x), signals[(index + 1) % 2])
            runs.append(
                partial(
                    run_axis,
                    plant,
                    axis if method is None else axis.for_method(method),
                    self.centre_m[name] + self.radius_m * signals[index % 2],
                    disturbance=motion_m if plant.motions else None,
                    fault=fault,
                    has_approach=True,
                )
            )
        return self.run(runs)

    def track(self, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]) -> Tracking:
        """Return the tracking errors of records along a path."""
        return track(
            {name: r.reference - self.centre_m[name] for name, r in records.items()},
            {name: r.position - self.centre_m[name] for name, r in records.items()},
            path=path,
            radius_m=self.radius_m,
            frequency_Hz=scenario.frequency_Hz,
            sampling_rate_Hz=self.rate_Hz,
        )
