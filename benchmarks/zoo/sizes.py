"""Model errors of effect sizes: stated sizes against the true ones on stages of the zoo.

    python -m benchmarks.zoo --kinds single --cases 17 --seeds 930000 --json build/sizes.jsonl \\
        --effects creep,delay,lag,resonance,slew_limit,gain_change,amplifier_saturation
    python -m benchmarks.zoo.sizes [--json build/sizes.jsonl]

A size s has the standard error d from its blocks and a relative model error k, because the law of
the effect or the hysteresis differs from that of the stage,

    |s - truth| <= 2 sqrt(d^2 + (k s)^2)    in 95 of 100 stages.

The required k of a stage makes this an equation. The table states the largest required k of any
law, and how many intervals of each law contain the truth with the largest k of all other laws.
"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from math import sqrt
from pathlib import Path
from statistics import median_high

from benchmarks.zoo.__main__ import read
from benchmarks.zoo.table import share
from piezoid.diagnosis.candidate import QUANTILE
from piezoid.diagnosis.effects import EFFECTS

MODEL_ERROR = {effect.name: effect.model_error for effect in EFFECTS}


@dataclass(frozen=True, kw_only=True)
class SizeError:
    """Error of one stated size, relative to the size.

    error           size minus truth
    standard_error  from the blocks
    half_width      of the stated interval
    """

    law: str
    error: float
    standard_error: float
    half_width: float

    @property
    def required_model_error(self) -> float:
        """Model error k at which the interval ends at the truth."""
        return sqrt(max((self.error / QUANTILE) ** 2 - self.standard_error**2, 0.0))


def main() -> None:
    """Print a row for each effect."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--json", type=Path, default=Path("build/sizes.jsonl"))
    errors: dict[str, list[SizeError]] = {}
    for case in read(parser.parse_args().json).values():
        for finding in case.findings:
            if finding.truth is None or finding.value == 0.0:
                continue
            size = abs(finding.value)
            half_width = (finding.ci95[1] - finding.value) / size
            variance = (half_width / QUANTILE) ** 2 - MODEL_ERROR[finding.name] ** 2
            errors.setdefault(finding.name, []).append(
                SizeError(
                    law=case.law,
                    error=(finding.value - finding.truth) / size,
                    standard_error=sqrt(max(variance, 0.0)),
                    half_width=half_width,
                )
            )
    print(
        "| effect | sizes | model error | intervals that hold | largest required model error "
        "| intervals that hold with the largest of the other laws | median error "
        "| median half width |\n" + "| --- " * 8 + "|"
    )
    for name, sizes in sorted(errors.items()):
        print(_row(name, sizes))


def _row(name: str, sizes: Sequence[SizeError]) -> str:
    covered = sum(abs(size.error) <= size.half_width for size in sizes)
    covered_by_others = sum(
        size.required_model_error
        <= max((s.required_model_error for s in sizes if s.law != size.law), default=0.0)
        for size in sizes
    )
    return (
        f"| {name} | {len(sizes)} | {MODEL_ERROR[name]:g} | {share(covered, len(sizes))} | "
        f"{max(size.required_model_error for size in sizes):.2g} | "
        f"{share(covered_by_others, len(sizes))} | "
        f"{median_high([abs(size.error) for size in sizes]):.2g} | "
        f"{median_high([size.half_width for size in sizes]):.2g} |"
    )


if __name__ == "__main__":
    main()
