"""What the laws behind sizes may be wrong by: errors of sizes on stages of the zoo.

    python -m benchmarks.zoo --kinds single --cases 17 --seeds 930000 --json build/sizes.jsonl \\
        --effects creep,delay,lag,resonance,slew_limit,gain_change,amplifier_saturation
    python -m benchmarks.zoo.sizes [--json build/sizes.jsonl]

A size s has the standard error d that its blocks tell, and may be wrong by a part k of it because
the effect's law, or the hysteresis beside it, is not quite the stage's,

    |s - truth| <= 2 sqrt(d^2 + (k s)^2)    in 95 of 100 stages.

A stage asks for the k at which this is an equation; printed are the largest k that any law asks
for, and how many sizes of each law the intervals hold with the largest k of all *other* laws.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path

from benchmarks.zoo.__main__ import read
from benchmarks.zoo.table import share
from piezoid.diagnosis.candidate import QUANTILE
from piezoid.diagnosis.effects import EFFECTS

KNOWN_TO = {effect.name: effect.model_error for effect in EFFECTS}


@dataclass(frozen=True, kw_only=True)
class Error:
    """A size beside the truth, both as parts of the size.

    off     size less truth
    spread  standard error that blocks tell
    stated  half of the interval that was stated
    """

    law: str
    off: float
    spread: float
    stated: float

    @property
    def asks(self) -> float:
        """Return the part k that makes the interval end at the truth."""
        return sqrt(max((self.off / QUANTILE) ** 2 - self.spread**2, 0.0))

    def holds(self, part: float) -> bool:
        """Tell whether the interval with another part k holds the truth."""
        return self.asks <= part


def main() -> None:
    """Print a row for each effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--json", type=Path, default=Path("build/sizes.jsonl"))
    errors: dict[str, list[Error]] = {}
    for case in read(parser.parse_args().json).values():
        for said in case.said:
            if said.truth is None or said.value == 0.0:
                continue
            reach = (said.ci95[1] - said.value) / abs(said.value)
            spread = sqrt(max((reach / QUANTILE) ** 2 - KNOWN_TO[said.name] ** 2, 0.0))
            off = (said.value - said.truth) / abs(said.value)
            one = Error(law=case.law, off=off, spread=spread, stated=reach)
            errors.setdefault(said.name, []).append(one)
    print(
        "| effect | sizes | known to | held as stated | asked for at most | held by other laws' k "
        "| median error | median half of the interval |\n| --- " * 1 + "| --- " * 7 + "|"
    )
    for name, found in sorted(errors.items()):
        print(_row(name, found))


def _row(name: str, found: Sequence[Error]) -> str:
    held = sum(abs(one.off) <= one.stated for one in found)
    others = sum(
        one.holds(max((o.asks for o in found if o.law != one.law), default=0.0)) for one in found
    )
    return (
        f"| {name} | {len(found)} | {KNOWN_TO[name]:g} | {share(held, len(found))} | "
        f"{max(one.asks for one in found):.2g} | {share(others, len(found))} | "
        f"{_median([abs(one.off) for one in found]):.2g} | "
        f"{_median([one.stated for one in found]):.2g} |"
    )


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    return ordered[len(ordered) // 2]


if __name__ == "__main__":
    main()
