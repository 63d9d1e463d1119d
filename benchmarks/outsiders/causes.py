"""Effects hidden by the simulator cedar: the names and coordinates that the diagnosis gives.

    python -m benchmarks.outsiders.causes [--first 1000] [--size 1.0] [--healthy 20] [--kinds a,b]

One stage for every kind of effect, including kinds outside the catalogue, and healthy stages. A
name is right if it is that of the hidden effect, or one that the author of the simulator declared
fair before the first run. ``initial_state`` is also right if the drive before the recordings
changes one of them by more than the noise.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.outsiders.cedar import campaigns
from benchmarks.zoo.score import INITIAL_STATE, LOOP_SHAPE, UNNAMED

FAIR = {
    "range_hard": {"amplifier_saturation"},
    "range_soft": {"amplifier_saturation"},
    "adc_missing_codes": {"quantisation"},
    "mux_glitch": {"outliers"},
    "dac_glitch": {"outliers"},
    "aircon": {"thermal_drift"},
    "slow_walk": {"thermal_drift"},
    "thyristor_spike": {"mains_interference"},
}
SETTLING_CYCLES = 30  # full cycles after which all laws are in a steady cycle
SIMULATOR_COORDINATE = {"time_since_turn": "since_turn", "distance_travelled": "distance"}


@dataclass(frozen=True, kw_only=True)
class CauseResult:
    """Findings on one stage.

    kind         of the hidden effect; empty for a healthy stage
    is_listed    whether the kind is in the catalogue
    times_noise  largest rms of the effect in a recording, over the noise
    names        of all findings, largest gain first
    coordinate   of the unexplained structure; empty if none is stated
    expected     right coordinates
    closure      held-out error of the final model over the noise
    past_times_noise  largest rms change of a recording, over the noise, if the drive had cycled
                 into a steady state before
    failed       message instead of a diagnosis
    """

    seed: int
    kind: str
    law: str
    is_listed: bool
    times_noise: float
    names: tuple[str, ...] = ()
    coordinate: str = ""
    expected: tuple[str, ...] = ()
    closure: float = 0.0
    past_times_noise: float = 0.0
    failed: str = ""
    seconds: float = 0.0

    @property
    def right(self) -> set[str]:
        """Right names for this stage."""
        initial_state = {INITIAL_STATE} if self.past_times_noise > 1.0 else set()
        return initial_state | ({self.kind} if self.is_listed else FAIR.get(self.kind, set()))

    @property
    def wrong(self) -> list[str]:
        """False names."""
        return [name for name in self.names if name not in self.right and name != UNNAMED]

    @property
    def is_found(self) -> bool:
        """Whether the diagnosis names the hidden effect, or finds its coordinate."""
        is_named = any(
            name in self.right - {INITIAL_STATE} or name == self.kind for name in self.names
        )
        return is_named or (not self.is_listed and self.coordinate in self.expected)


def evaluate(task: tuple[int, str, float]) -> CauseResult:
    """Diagnose one stage, given its seed, hidden effect and effect size."""
    seed, kind, size = task
    kinds = (kind,) if kind else ()
    start_s = perf_counter()
    with TemporaryDirectory() as scratch:
        folder = Path(scratch)
        truth = campaigns.write(seed, kinds, size, folder)
        description = campaigns.kinds().get(kind, {"catalogue": None, "coordinate": None})
        coordinates = description["coordinate"] or ()
        effect_rms = [
            recording["rms_over_noise"] or 0.0
            for effect in truth["effects"]
            for recording in effect["by_recording"].values()
        ]
        values = {
            "seed": seed,
            "kind": kind,
            "law": str(truth["law"]),
            "is_listed": description["catalogue"] is not None,
            "expected": (coordinates,) if isinstance(coordinates, str) else tuple(coordinates),
            "times_noise": float(max(effect_rms, default=0.0)),
            "past_times_noise": _past_times_noise(seed, kinds, size),
        }
        diagnosis, failed = _diagnose(folder)
    seconds = perf_counter() - start_s
    if diagnosis is None:
        return CauseResult(**values, failed=failed, seconds=seconds)
    findings = diagnosis["findings"]
    unnamed = [finding for finding in findings if finding["effect"] == UNNAMED]
    coordinate = unnamed[0].get("coordinate", "") if unnamed else ""
    coordinate = SIMULATOR_COORDINATE.get(coordinate, coordinate)
    return CauseResult(
        **values,
        names=tuple(f["effect"] for f in findings if f["effect"] != LOOP_SHAPE),
        coordinate="other_axis" if coordinate.startswith("drive of axis") else coordinate,
        closure=diagnosis["final"]["held_out_rms_m"] / truth["noise_m"],
        seconds=seconds,
    )


@dataclass(frozen=True)
class SettledLaw:
    """A law whose drive cycles over the full range before the last samples of its input."""

    law: campaigns.Law
    samples: int

    @property
    def poly(self) -> Any:
        """Reversible part of the law."""
        return self.law.poly

    def __call__(self, v: Any) -> Any:
        drive = v[-self.samples :]
        cycles = campaigns.triangle([1.0, -1.0] * SETTLING_CYCLES + [drive[0]], 300)
        settled = self.law(np.concatenate([cycles, drive]))[len(cycles) :]
        return np.concatenate([np.zeros(len(v) - self.samples), settled])


def _past_times_noise(seed: int, kinds: tuple[str, ...], size: float) -> float:
    stage, settled = (campaigns.Stage(seed, kinds, size) for _ in range(2))
    changes = []
    for index, plan in enumerate(stage.plan):
        settled.law = SettledLaw(stage.law, len(plan["u"]))
        change_m = settled.run(index, kinds)[3] - stage.run(index, kinds)[3]
        changes.append(float(np.sqrt(np.mean(change_m**2))) / stage.noise)
    return max(changes, default=0.0)


def _diagnose(folder: Path) -> tuple[dict | None, str]:
    """Run ``piezoid diagnose``; return its record, or None and its message."""
    out = folder / "found"
    program = Path(sys.executable).with_name("piezoid")
    files = sorted(folder.glob("*.csv"))
    command = [program, "diagnose", *files, "--lab", folder / "lab.toml", "--out", out, "--quiet"]
    process = subprocess.run([*map(str, command), "--axis", "x"], capture_output=True, text=True)
    path = out / "diagnosis.json"
    if not path.exists():
        return None, " ".join((process.stderr or process.stdout).split())[-300:]
    return json.loads(path.read_bytes()), ""


def table(rows: Sequence[CauseResult]) -> str:
    """Return the numbers of named effects, right names and healthy stages with a false name."""
    listed = [row for row in rows if row.is_listed]
    unlisted = [row for row in rows if row.kind and not row.is_listed]
    healthy = [row for row in rows if not row.kind]
    accused = sum(any(name not in row.right for name in row.names) for row in healthy)
    names = sum(len(row.names) for row in listed)
    wrong = sum(len(row.wrong) for row in listed)
    return "\n".join(
        (
            f"in the catalogue: {sum(row.is_found for row in listed)} of {len(listed)} named, "
            f"{names - wrong} of {names} names right",
            f"outside: {sum(row.is_found for row in unlisted)} of {len(unlisted)} with the right "
            f"coordinate, {sum(bool(row.wrong) for row in unlisted)} with a wrong name, "
            f"{sum(not row.names and not row.failed for row in unlisted)} without a finding",
            f"healthy: {accused} of {len(healthy)} with a false finding; "
            f"refused: {sum(bool(row.failed) for row in rows)} of {len(rows)}",
        )
    )


def _line(row: CauseResult) -> str:
    names = ", ".join(row.names) or row.failed or "nothing"
    coordinate = f" [{row.coordinate}]" if row.coordinate else ""
    mark = "+" if row.is_found else ("-" if row.kind else " ")
    return (
        f"{mark}{'!' if row.wrong else ' '} {row.seed} {row.kind or 'healthy'} ({row.law}), "
        f"effect {row.times_noise:.1f} times the noise, initial state {row.past_times_noise:.1f}: "
        f"{names}{coordinate}; closure {row.closure:.2f}, {row.seconds:.0f} s"
    )


def main() -> None:
    """Evaluate all kinds, print a line for each, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--kinds", default=",".join(campaigns.kinds()))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("build/outsiders/causes.jsonl"))
    options = parser.parse_args()
    kinds = [kind for kind in options.kinds.split(",") if kind] + [""] * options.healthy
    tasks = [(options.first + index, kind, options.size) for index, kind in enumerate(kinds)]
    options.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    pool = ProcessPoolExecutor(options.processes, mp_context=get_context("spawn"))
    with pool, options.out.open("w") as file:
        for row in pool.map(evaluate, tasks):
            rows.append(row)
            file.write(json.dumps(asdict(row)) + "\n")
            file.flush()
            print(_line(row), flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
