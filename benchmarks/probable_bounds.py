"""Coverage of the probable error bound on stages of third-party simulators.

    python -m benchmarks.probable_bounds [--stages 700-711] [--kept FOLDER]

Each stage is recorded and calibrated, and its bounds are computed. The shipped controller then
follows the random references of ``benchmarks.outsiders`` on the simulated stage, at the three
speeds of the bounds. One run in twenty may exceed a bound of 95 %.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.lateral import LIMITED, evaluate_stage, largest_error_m
from benchmarks.outsiders.simulators import NAMES, load_simulator, seed_range
from piezoid.verification.bounds import error_bounds
from piezoid.verification.verification import ErrorBound
from piezoid.verification.verify_stage import stage_plants
from piezoid_cli.stage_files import StageFolder

RUNS = 20  # at each speed


@dataclass(frozen=True, kw_only=True)
class BoundCoverage:
    """The bounds of one stage at one speed, and the largest error of each run."""

    stage: str
    law: str
    bound: ErrorBound
    errors_m: tuple[float, ...]

    @property
    def inside(self) -> int:
        """Number of runs below the probable bound."""
        return sum(error_m <= self.bound.probable_m for error_m in self.errors_m)


def coverage_of(name: str, seed: int, parent: Path) -> Iterator[BoundCoverage]:
    """Yield bounds and true errors of one stage, if a controller ships.

    parent  folder that keeps the calibrated stages
    """
    folder = parent / f"{name}-{seed}"
    if not folder.exists():
        evaluate_stage(name, seed, parent)
    if not (folder / "params.json").exists():
        return
    stage = StageFolder(folder, folder / "recordings" / "lab.toml")
    file, model = stage.parameters, stage.model
    plants, family_plants = stage_plants(file, model, stage.lab)
    simulator = load_simulator(name)
    for index, bound in enumerate(error_bounds(file, stage.design, model, plants, family_plants)):
        rng = np.random.default_rng([seed, index])
        errors_m = (
            largest_error_m(
                simulator,
                seed,
                200 + RUNS * index + k,
                file.axes[0],
                slew_m_per_s=bound.slew_m_per_s,
                rng=rng,
                excluded=LIMITED,
            )
            for k in range(RUNS)
        )
        yield BoundCoverage(
            stage=f"{name} {seed}",
            law=simulator.stage_law(seed),
            bound=bound,
            errors_m=tuple(error_m for error_m in errors_m if error_m is not None),
        )


def summary(rows: list[BoundCoverage]) -> str:
    """Return a row for each speed: coverage, stages within it, and ratios of the bounds."""
    lines = [
        "| fastest reference | stages | runs | below the probable bound | stages with 18 of 20 or "
        "more | bounded / probable | probable / largest true | worst found / largest true |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    stages = list(dict.fromkeys(row.stage for row in rows))
    by_speed = zip(*([row for row in rows if row.stage == stage] for stage in stages), strict=True)
    for speed, speed_rows in zip(("1", "0.3", "0.1"), by_speed, strict=True):
        tested = [row for row in speed_rows if row.errors_m]
        runs, inside = sum(len(row.errors_m) for row in tested), sum(row.inside for row in tested)
        covered = sum(row.inside >= 0.9 * len(row.errors_m) for row in tested)
        guaranteed = [
            row.bound.bound_m / row.bound.probable_m for row in tested if row.bound.bound_m
        ]
        probable = [row.bound.probable_m / max(row.errors_m) for row in tested]
        search = [row.bound.worst_found_m / max(row.errors_m) for row in tested]
        lines.append(
            f"| {speed} of the certified | {len(tested)} | {runs} | {inside / runs:.1%} | "
            f"{covered} | {np.median(guaranteed):.0f} ({len(guaranteed)}) | "
            f"{np.median(probable):.2f} | {np.median(search):.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print every row, then the table."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--stages", default="700-711", help="seeds of each simulator")
    parser.add_argument("--kept", type=Path, help="folder that keeps the calibrated stages")
    options = parser.parse_args()
    rows: list[BoundCoverage] = []
    with TemporaryDirectory() as scratch:
        for seed in seed_range(options.stages):
            for name in NAMES:
                for row in coverage_of(name, seed, options.kept or Path(scratch)):
                    rows.append(row)
                    bound = row.bound
                    guaranteed = "none" if bound.bound_m is None else f"{1e9 * bound.bound_m:.0f}"
                    print(
                        f"{row.stage:10} {row.law:28} {1e3 * bound.slew_m_per_s:.3g} mm/s: "
                        f"bounded {guaranteed}, probable {1e9 * bound.probable_m:.0f}, "
                        f"worst found {1e9 * bound.worst_found_m:.0f}, "
                        f"simulated {1e9 * bound.simulated_m:.0f}"
                        f", true {1e9 * max(row.errors_m, default=np.nan):.0f} nm at most; "
                        f"{row.inside} of {len(row.errors_m)} below",
                        flush=True,
                    )
    print(summary(rows))


if __name__ == "__main__":
    main()
