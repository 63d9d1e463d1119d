"""Hidden effects of an outsider: what the diagnosis names, and what it says of the rest.

    python -m benchmarks.outsiders.causes [--first 1000] [--size 1.0] [--healthy 20] [--kinds a,b]

One stage for every kind of effect, those in no catalogue among them, and some healthy ones. A name
is right where it is the hidden effect's, or one that the simulator's author called a fair answer
before anything was run; an ``initial_state`` also where the past moves a record by more than the
noise.
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
ELSE = "something_else"
LOOPS = "loop_shape"  # a property of the class of model, true of most laws
PAST = "initial_state"
SETTLED = 30  # full cycles, after which no law here moves any more
OTHER_WORD = {"time_since_turn": "since_turn", "distance_travelled": "distance"}


@dataclass(frozen=True, kw_only=True)
class CauseResult:
    """What was said of one stage.

    kind         hidden; "": a healthy stage
    is_listed    whether the catalogue has it
    times_noise  rms of the effect in the recording that shows it most
    names        of all findings, largest gain first
    coordinate   that something else was said to live in; "": nothing was
    expected     coordinates that are right
    left         of the noise, what the final model leaves
    past_times_noise  what the past of the records changes against full cycles until nothing moved,
                 in the recording that shows it most
    failed       what was said instead of a diagnosis
    """

    seed: int
    kind: str
    law: str
    is_listed: bool
    times_noise: float
    names: tuple[str, ...] = ()
    coordinate: str = ""
    expected: tuple[str, ...] = ()
    left: float = 0.0
    past_times_noise: float = 0.0
    failed: str = ""
    seconds: float = 0.0

    @property
    def right(self) -> set[str]:
        """Names that may be said of this stage."""
        past = {PAST} if self.past_times_noise > 1.0 else set()
        return past | ({self.kind} if self.is_listed else FAIR.get(self.kind, set()))

    @property
    def wrong(self) -> list[str]:
        """Names that were said and may not be."""
        return [n for n in self.names if n not in self.right and n != ELSE]

    @property
    def is_found(self) -> bool:
        """Whether the hidden effect was named, or placed where it lives."""
        named = any(n in self.right - {PAST} or n == self.kind for n in self.names)
        return named if self.is_listed else named or self.coordinate in self.expected


def judge(task: tuple[int, str, float]) -> CauseResult:
    """Hide one effect and read diagnosis.json."""
    seed, kind, size = task
    begun = perf_counter()
    with TemporaryDirectory() as scratch:
        place = Path(scratch)
        truth = campaigns.write(seed, (kind,) if kind else (), size, place)
        shown = campaigns.kinds().get(kind, {"catalogue": None, "coordinate": None})
        coordinates = shown["coordinate"] or ()
        expected = (coordinates,) if isinstance(coordinates, str) else tuple(coordinates)
        known = {
            "seed": seed,
            "kind": kind,
            "law": str(truth["law"]),
            "is_listed": shown["catalogue"] is not None,
            "expected": expected,
            "times_noise": _times_noise(truth),
            "past_times_noise": _past_times_noise(seed, (kind,) if kind else (), size),
        }
        found, failed = _diagnosed(place)
    seconds = perf_counter() - begun
    if found is None:
        return CauseResult(**known, failed=failed, seconds=seconds)
    rest = [f for f in found["findings"] if f["effect"] == ELSE]
    return CauseResult(
        **known,
        names=tuple(f["effect"] for f in found["findings"] if f["effect"] != LOOPS),
        coordinate=_in_its_words(rest[0].get("coordinate", "")) if rest else "",
        left=found["final"]["held_out_rms_m"] / truth["noise_m"],
        seconds=seconds,
    )


def _in_its_words(coordinate: str) -> str:
    """Return the simulator's word for a coordinate of ours."""
    word = OTHER_WORD.get(coordinate, coordinate)
    return "other_axis" if word.startswith("drive of axis") else word


def _times_noise(truth: dict) -> float:
    shown = [
        r["rms_over_noise"] or 0.0 for e in truth["effects"] for r in e["by_recording"].values()
    ]
    return float(max(shown, default=0.0))


@dataclass(frozen=True)
class Settled:
    """A law that cycled over the full range for long before the last samples of its input."""

    law: campaigns.Law
    samples: int

    @property
    def poly(self) -> Any:
        """Its reversible part."""
        return self.law.poly

    def __call__(self, v: Any) -> Any:
        drive = v[-self.samples :]
        past = campaigns.triangle([1.0, -1.0] * SETTLED + [drive[0]], 300)
        settled = self.law(np.concatenate([past, drive]))[len(past) :]
        return np.concatenate([np.zeros(len(v) - self.samples), settled])


def _past_times_noise(seed: int, kinds: tuple[str, ...], size: float) -> float:
    found, settled = (campaigns.Stage(seed, kinds, size) for _ in range(2))
    most = 0.0
    for place, planned in enumerate(found.plan):
        settled.law = Settled(found.law, len(planned["u"]))
        change_m = settled.run(place, kinds)[3] - found.run(place, kinds)[3]
        most = max(most, float(np.sqrt(np.mean(change_m**2))) / found.noise)
    return most


def _diagnosed(place: Path) -> tuple[dict | None, str]:
    out = place / "found"
    verb = Path(sys.executable).with_name("piezoid")
    files = sorted(place.glob("*.csv"))
    asked = [verb, "diagnose", *files, "--lab", place / "lab.toml", "--out", out, "--quiet"]
    done = subprocess.run([*map(str, asked), "--axis", "x"], capture_output=True, text=True)
    held = out / "diagnosis.json"
    if not held.exists():
        return None, " ".join((done.stderr or done.stdout).split())[-300:]
    return json.loads(held.read_bytes()), ""


def table(rows: Sequence[CauseResult]) -> str:
    """Return how many were found, how many names are right, and who was accused in vain."""
    listed = [r for r in rows if r.is_listed]
    others = [r for r in rows if r.kind and not r.is_listed]
    healthy = [r for r in rows if not r.kind]
    accused = [r for r in healthy if any(n not in r.right for n in r.names)]
    named = [n for r in listed for n in r.names]
    wrong = sum(len(r.wrong) for r in listed)
    return "\n".join(
        (
            f"in the catalogue: {sum(r.is_found for r in listed)} of {len(listed)} named, "
            f"{len(named) - wrong} of {len(named)} names right",
            f"in none: {sum(r.is_found for r in others)} of {len(others)} placed, "
            f"{sum(bool(r.wrong) for r in others)} with a wrong name, "
            f"{sum(not r.names and not r.failed for r in others)} unnoticed",
            f"healthy: {len(accused)} of {len(healthy)} with a finding that is not there; "
            f"refused: {sum(bool(r.failed) for r in rows)} of {len(rows)}",
        )
    )


def _line(r: CauseResult) -> str:
    said = ", ".join(r.names) or r.failed or "nothing"
    where = f" [{r.coordinate}]" if r.coordinate else ""
    mark = "+" if r.is_found else ("-" if r.kind else " ")
    return (
        f"{mark}{'!' if r.wrong else ' '} {r.seed} {r.kind or 'healthy'} ({r.law}), "
        f"{r.times_noise:.1f} times the noise, its past {r.past_times_noise:.1f}: "
        f"{said}{where}; left {r.left:.2f}, {r.seconds:.0f} s"
    )


def main() -> None:
    """Judge all kinds, print a line for each, then the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--size", type=float, default=1.0)
    parser.add_argument("--healthy", type=int, default=20)
    parser.add_argument("--kinds", default=",".join(campaigns.kinds()))
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--out", type=Path, default=Path("build/outsiders/causes.jsonl"))
    asked = parser.parse_args()
    kinds = [k for k in asked.kinds.split(",") if k] + [""] * asked.healthy
    tasks = [(asked.first + place, kind, asked.size) for place, kind in enumerate(kinds)]
    asked.out.parent.mkdir(parents=True, exist_ok=True)
    rows = []
    pool = ProcessPoolExecutor(asked.processes, mp_context=get_context("spawn"))
    with pool, asked.out.open("w") as file:
        for found in pool.map(judge, tasks):
            rows.append(found)
            file.write(json.dumps(asdict(found)) + "\n")
            file.flush()
            print(_line(found), flush=True)
    print(table(rows))


if __name__ == "__main__":
    main()
