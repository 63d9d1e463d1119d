"""The tip over a rough surface, taken where the lateral axes go."""

from collections.abc import Mapping

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification import criteria
from piezoid.verification.bench import Bench, Run
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.scenarios import Scenario
from piezoid.verification.surface import RoughSurface
from piezoid.verification.trajectories import Path
from piezoid.verification.verification import CurrentRow

_ROUGHNESS_m = 0.1e-9
_WAVELENGTH = 0.5  # of the radius, the surface's shortest
_WITHOUT_PATH_m = 1e-6  # radius a tip is given that has no lateral axes


def judge_tips(
    bench: Bench, scenario: Scenario, path: Path, records: Mapping[str, LoopRecord]
) -> None:
    """Judge every tip while the stage moves it over a rough surface."""
    for name, record in run_tips(bench, path, records, bench.plants).items():
        response = _junction(bench.plants[name])
        verdicts = criteria.tunnelling(scenario.name, record, bench.limits)
        bench.currents.append(
            CurrentRow(
                scenario=scenario.name,
                ln_current_std=verdicts[0].value,
                height_rms_m=verdicts[0].value / response.decay_per_m,
                largest_ratio=float(record.position.max()) / response.current_A,
                retracted_samples=int(verdicts[1].value),
            )
        )
        if scenario.frequency_Hz <= bench.limits.judged_Hz:
            bench.verdicts.extend(verdicts)


def run_tips(
    bench: Bench,
    path: Path,
    records: Mapping[str, LoopRecord],
    plants: Mapping[str, AxisPlant],
) -> dict[str, LoopRecord]:
    """Let every tip regulate its current where the lateral axes took it."""
    radius_m = bench.radius_m or _WITHOUT_PATH_m
    ways = [r.position - bench.centre_m[name] for name, r in records.items()]
    ideal = [radius_m * path.x, radius_m * path.y]
    surface = RoughSurface(rms_m=_ROUGHNESS_m, shortest_m=_WAVELENGTH * radius_m)
    height_m = surface.height(*(*ways, *ideal[len(ways) :])[:2])
    return bench.run([_over(bench, name, plants[name], height_m) for name in bench.tunnelling])


def _over(bench: Bench, name: str, plant: AxisPlant, height_m: Array) -> Run:
    response = _junction(plant)
    return Run(
        axis=bench.file.axis(name),
        plant=plant,
        reference=np.full(len(height_m), response.current_A),
        disturbance=response.decay_per_m * height_m,
    )


def _junction(plant: AxisPlant) -> Junction:
    assert isinstance(plant.response, Junction)
    return plant.response
