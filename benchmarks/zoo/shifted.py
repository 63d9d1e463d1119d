"""Null distribution of an effect from shifted and reversed columns of the same data.

    python -m benchmarks.zoo.shifted [--cases 1] [--seeds 3200000]

On healthy stages of every law, each effect of the catalogue gets its score test with individual
initial states. Its gain on the n held-out blocks,

    g = -n log(rms with / rms without),

is compared with that of placebos: the same columns, rolled by a random number of samples within
each recording. Every other placebo is reversed in time. An exponential tail above their median
extrapolates small p-values, which are multiplied by the number of tested effects (Bonferroni).
The program prints the effects below 5 %; a valid null accuses one stage in twenty. Hysteresis
residuals are locked to the drive, as are the columns of an effect, but rolled columns are not.
"""

from dataclasses import dataclass
from itertools import pairwise
from math import log

import numpy as np

from benchmarks.zoo.command_line import stage_parser
from benchmarks.zoo.score import StageRequest, read_campaign
from benchmarks.zoo.stages import NAMES, draw_stage, stage_requests
from piezoid.diagnosis.blocked_regression import Null
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.effects import EFFECTS
from piezoid.diagnosis.nuisance_search import (
    with_individual_initial_states,
    with_shared_initial_state,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import ScoreTest, null_of, score_test
from piezoid.diagnosis.segments import BLOCKS
from piezoid.diagnosis.selection import repair_faults
from piezoid.numerics.arrays import Array
from piezoid.numerics.executor import SERIAL

PLACEBOS = 40
LEVEL = 0.05
MIN_SHIFT = 0.05  # of the length of a recording


@dataclass(frozen=True, kw_only=True)
class FalseName:
    """An effect with more evidence than its placebos.

    gain     1 - rms with / rms without
    p_value  times the number of tested effects
    """

    name: str
    gain: float
    p_value: float


def false_names(request: StageRequest) -> list[FalseName]:
    """Return the effects that this null names on a healthy stage."""
    recordings, lab = read_campaign(draw_stage(request))
    clean, _, _ = repair_faults(view_on(recordings, axis="x", lab=lab), SERIAL)
    view = with_individual_initial_states(clean, with_shared_initial_state(clean, SERIAL))
    view = min(clean, view, key=lambda candidate: candidate.rms)
    tests = [
        test
        for effect in EFFECTS
        if effect.structural is None
        and not effect.untestable(view)
        and (test := score_test(effect, view)) is not None
        and test.physical
    ]
    names = [
        FalseName(
            name=test.effect.name, gain=test.cv.gain, p_value=len(tests) * _p_value(test, view)
        )
        for test in tests
    ]
    return [name for name in names if name.p_value < LEVEL]


def _p_value(test: ScoreTest, view: View) -> float:
    null, rng = null_of(test.effect, view), np.random.default_rng(5)
    blocks = len(null.edges)
    gains = []
    for k in range(PLACEBOS):
        columns = _placebo(test.trial.columns, null, rng, is_reversed=k % 2 == 1)
        gains.append(-blocks * log(1.0 - null.cross_validated(columns).gain))
    gain, median = -blocks * log(1.0 - test.cv.gain), float(np.median(gains))
    if gain <= median:
        return 1.0
    excess = float(np.mean([value - median for value in gains if value >= median]))
    return 0.5 * float(np.exp(-(gain - median) / max(excess, 1e-9)))


def _placebo(columns: Array, null: Null, rng: np.random.Generator, *, is_reversed: bool) -> Array:
    """Roll the columns of each recording by a random number of rows."""
    recording = null.block // BLOCKS
    edges = [0, *(np.flatnonzero(np.diff(recording)) + 1).tolist(), len(recording)]
    placebo = np.empty_like(columns)
    for start, stop in pairwise(edges):
        rows = columns[start:stop][::-1] if is_reversed else columns[start:stop]
        shift = max(1, int(MIN_SHIFT * (stop - start)))
        placebo[start:stop] = np.roll(rows, rng.integers(shift, stop - start - shift), axis=0)
    return placebo


def main() -> None:
    """Print a line for each stage, then the number of accused stages."""
    options = stage_parser(__doc__, cases=1, first=3_200_000).parse_args()
    accused = 0
    requests = list(stage_requests(NAMES, ["healthy"], options.cases, options.seeds))
    for request in requests:
        names = false_names(request)
        accused += bool(names)
        listed = ", ".join(f"{n.name} (gain {n.gain:.1%}, p {n.p_value:.1g})" for n in names)
        print(f"{request.law} {request.seed}: {listed or 'nothing'}", flush=True)
    print(f"{accused} of {len(requests)} healthy stages accused at {LEVEL:.0%}")


if __name__ == "__main__":
    main()
