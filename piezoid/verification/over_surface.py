"""The tip over a rough surface, taken where the lateral axes go."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.verification import criteria
from piezoid.verification.bench import Bench, Run
from piezoid.verification.closed_loop import LoopRecord
from piezoid.verification.plant import AxisPlant, Junction
from piezoid.verification.scenarios import Path, Scenario
from piezoid.verification.verification import CurrentRow

_WAVES = 40

_ROUGHNESS_m = 0.1e-9
_WAVELENGTH = 0.5  # of the radius, the surface's shortest
_WITHOUT_PATH_m = 1e-6  # radius a tip is given that has no lateral axes


@dataclass(frozen=True, kw_only=True)
class RoughSurface:
    """A sum of plane waves of random direction, equal height and wavelengths over a decade.

    rms_m       roughness, > 0
    shortest_m  wavelength, > 0; the longest is ten times that
    seed        which surface
    """

    rms_m: float
    shortest_m: float
    seed: int = 0

    def height(self, x_m: Array, y_m: Array) -> Array:
        """Return the height at each point, (samples,) m; 0 at the origin."""
        rng = np.random.default_rng(self.seed)
        wavelength = self.shortest_m * 10.0 ** rng.uniform(0.0, 1.0, _WAVES)
        direction, phase = rng.uniform(0.0, 2.0 * np.pi, (2, _WAVES))
        found = np.zeros_like(x_m)
        for w, d, p in zip(2.0 * np.pi / wavelength, direction, phase, strict=True):
            found += np.cos(w * (x_m * np.cos(d) + y_m * np.sin(d)) + p) - np.cos(p)
        return np.asarray(self.rms_m * np.sqrt(2.0 / _WAVES) * found)


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
