"""How often the probable bound of the error holds, on stages whose authors never saw piezoid.

    python -m benchmarks.probable_bounds [--stages 700-711] [--kept FOLDER]

Each stage is recorded and calibrated, and its bounds are computed from what that left. Then what
ships follows references on the stage itself, sines, triangles, ramps and sums of sines, at the
three speeds for which the bounds hold, half a second each, as ``benchmarks.outsiders`` has them.
A stage whose bound is 95 % is to break it in one run of twenty.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.outsiders.lateral import BOUND_s, _slewed, _within, judge, led_to, middle_of
from benchmarks.outsiders.simulators import NAMES, RATE_Hz, simulator, track
from piezoid.design.design import design_from_json
from piezoid.export.parameter_file import AxisParameters, from_json
from piezoid.identification.store import read_model
from piezoid.numerics.arrays import Array
from piezoid.records.lab import read_lab
from piezoid.runtime.controller import Status
from piezoid.verification.bounds import error_bounds
from piezoid.verification.verification import ErrorBound
from piezoid.verification.verify_stage import stage_plants

RUNS = 20  # at each speed
_OUTSIDE = Status.VOLTAGE_LIMITED | Status.REFERENCE_LIMITED | Status.VOLTAGE_STEP


@dataclass(frozen=True, kw_only=True)
class Held:
    """The bounds of one stage at one speed, and the largest error of each true run."""

    stage: str
    law: str
    bound: ErrorBound
    errors_m: tuple[float, ...]

    @property
    def inside(self) -> int:
        """How many runs stayed below what is probable."""
        return sum(error <= self.bound.probable_m for error in self.errors_m)


def held_on(name: str, seed: int, kept: Path) -> Iterator[Held]:
    """Yield the bounds of one stage beside its true errors; nothing where none ships."""
    folder = kept / f"{name}-{seed}"
    if not folder.exists():
        judge(name, seed, kept)
    if not (folder / "params.json").exists():
        return
    lab = read_lab(folder / "recordings" / "lab.toml")
    model = read_model((folder / "model.json").read_bytes(), "model.json")
    design = design_from_json((folder / "design.json").read_bytes(), "design.json")
    file = from_json((folder / "params.json").read_bytes(), "params.json")
    plants, drawn = stage_plants(file, model, lab)
    made = simulator(name)
    law = str(made.campaigns.stage_truth(seed, made.library).get("law", "?"))
    for place, bound in enumerate(error_bounds(file, design, model, plants, drawn)):
        rng = np.random.default_rng([seed, place])
        errors = (
            _error(name, seed, file.axes[0], bound.slew_m_per_s, rng, 200 + RUNS * place + k)
            for k in range(RUNS)
        )
        yield Held(
            stage=f"{name} {seed}",
            law=law,
            bound=bound,
            errors_m=tuple(error for error in errors if error is not None),
        )


def _error(
    name: str,
    seed: int,
    shipped: AxisParameters,
    fastest: float,
    rng: np.random.Generator,
    noise_seed: int,
) -> float | None:
    """Return the largest error of one run, None where the runtime said it was outside."""
    slew, ahead = 0.999 * fastest, int(shipped.values["preview_samples"])
    kept: dict[str, Array] = {}

    def wanted(rest_m: float) -> Array:
        middle_m, reach_m = middle_of(shipped)
        asked = middle_m + _within(rng, slew, 0.95 * reach_m)
        kept["wanted"] = _slewed(np.concatenate([led_to(middle_m, rest_m), asked]), slew, rest_m)
        return kept["wanted"]

    run = track(simulator(name), seed, noise_seed, shipped.values, None, wanted)
    led = len(kept["wanted"]) - int(BOUND_s * RATE_Hz)
    if np.any(run.status[led:] & np.uint32(_OUTSIDE)):
        return None
    position = np.concatenate([[run.rest], run.position[:-1]])
    late = np.concatenate([np.full(ahead, run.rest), kept["wanted"]])[: len(position)]
    return float(np.abs(position - late)[led:].max())


def summary(rows: list[Held]) -> str:
    """Return a row for each speed: coverage, stages by how often, and how wide all of it is."""
    lines = [
        "| fastest reference | stages | runs | below the probable bound | stages with 18 of 20 or "
        "more | bounded / probable | probable / largest true | worst found / largest true |",
        "| --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    stages = list(dict.fromkeys(row.stage for row in rows))
    by_speed = zip(*([row for row in rows if row.stage == stage] for stage in stages), strict=True)
    for share, each in zip(("1", "0.3", "0.1"), by_speed, strict=True):
        own = [row for row in each if row.errors_m]
        runs, inside = sum(len(r.errors_m) for r in own), sum(r.inside for r in own)
        often = sum(row.inside >= 0.9 * len(row.errors_m) for row in own)
        tighter = [r.bound.bound_m / r.bound.probable_m for r in own if r.bound.bound_m]
        wide = [row.bound.probable_m / max(row.errors_m) for row in own]
        sought = [row.bound.worst_found_m / max(row.errors_m) for row in own]
        lines.append(
            f"| {share} of the certified | {len(own)} | {runs} | {inside / runs:.1%} | {often} | "
            f"{np.median(tighter):.0f} ({len(tighter)}) | {np.median(wide):.2f} | "
            f"{np.median(sought):.2f} |"
        )
    return "\n".join(lines)


def main() -> None:
    """Print every row, then the table."""
    asked = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    asked.add_argument("--stages", default="700-711", help="seeds of each outsider")
    asked.add_argument("--kept", type=Path, default=None, help="calibrated stages, kept here")
    given = asked.parse_args()
    first, _, last = given.stages.partition("-")
    rows: list[Held] = []
    with TemporaryDirectory() as scratch:
        for seed in range(int(first), int(last or first) + 1):
            for name in NAMES:
                for row in held_on(name, seed, given.kept or Path(scratch)):
                    rows.append(row)
                    b = row.bound
                    bounded = "none" if b.bound_m is None else f"{1e9 * b.bound_m:.0f}"
                    print(
                        f"{row.stage:10} {row.law:28} {1e3 * b.slew_m_per_s:.3g} mm/s: bounded "
                        f"{bounded}, probable {1e9 * b.probable_m:.0f}, worst found "
                        f"{1e9 * b.worst_found_m:.0f}, simulated {1e9 * b.simulated_m:.0f}, true "
                        f"{1e9 * max(row.errors_m, default=np.nan):.0f} nm at most; "
                        f"{row.inside} of {len(row.errors_m)} below",
                        flush=True,
                    )
    print(summary(rows))


if __name__ == "__main__":
    main()
