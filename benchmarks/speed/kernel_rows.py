"""Play bank, model and inverse: against loops, chains of min and max, and a copy."""

from collections.abc import Callable

import numpy as np

from benchmarks.speed import loops
from benchmarks.speed.drives import bank, drive_V, model, thresholds_V
from benchmarks.speed.machine import chains
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row
from piezoid.numerics.arrays import Array

BANK, FORWARD, INVERSE = "play bank", "model forward", "inverse"
LOOPED = 5000  # samples of the NumPy loops, which are slow
CLOSE = {"rtol": 1e-9, "atol": 1e-15}
PARTS = (16, 4, 1)  # one in so many of all samples
PLAYS = (4, 8, 16, 32, 64)


def kernel_rows(watch: Stopwatch, samples: int) -> list[Row]:
    """Return a row each, all results compared before they are timed."""
    u_V, known = drive_V(samples), model()
    rest = known.virgin_memory()
    y_m, _ = known.run(u_V, rest)
    columns = bank(u_V)
    forward_s = watch.cpu_s(lambda: known.run(u_V, rest))
    return [
        _bank_row(watch, u_V, columns),
        _row(
            watch,
            FORWARD,
            (lambda: known.run(u_V, rest)[0]),
            (lambda part: loops.numpy_forward(u_V[part], known)),
            (lambda: loops.numba_forward(u_V, known)),
            _in_chains(watch, forward_s, u_V),
        ),
        _row(
            watch,
            INVERSE,
            (lambda: known.inverse_run(y_m, rest)[0]),
            (lambda part: loops.numpy_inverse(y_m[part], known)),
            (lambda: loops.numba_inverse(y_m, known)),
            {"model forward": watch.cpu_s(lambda: known.inverse_run(y_m, rest)) / forward_s},
        ),
    ]


def _bank_row(watch: Stopwatch, u_V: Array, columns: Array) -> Row:
    wall, own_s = columns.copy(order="F"), watch.cpu_s(lambda: bank(u_V))
    return _row(
        watch,
        BANK,
        (lambda: bank(u_V)),
        (lambda part: loops.numpy_bank(u_V[part], thresholds_V())),
        (lambda: loops.numba_bank(u_V, thresholds_V())),
        {
            **_in_chains(watch, own_s, u_V),
            "copy of its columns": own_s / watch.cpu_s(lambda: np.copyto(wall, columns)),
        },
    )


def _in_chains(watch: Stopwatch, own_s: float, u_V: Array) -> dict[str, float]:
    work = chains(u_V, thresholds_V())
    if work is None:
        return {}
    np.testing.assert_array_equal(work(), bank(u_V)[-1])
    return {"chains of min and max": own_s / watch.cpu_s(work)}


def _row(
    watch: Stopwatch,
    stage: str,
    ours: Callable[[], Array],
    looped: Callable[[slice], Array],
    compiled: Callable[[], Array | None],
    bounds: dict[str, float],
) -> Row:
    """Return one row; the loops' results have to be ours."""
    expected, part = ours(), slice(0, LOOPED)
    np.testing.assert_allclose(looped(part), expected[part], **CLOSE)
    own_s, by_numba = watch.cpu_s(ours), compiled()
    if by_numba is not None:
        np.testing.assert_allclose(by_numba, expected, **CLOSE)
    return Row(
        stage=stage,
        loop=watch.cpu_s(lambda: looped(part)) / own_s * len(expected) / len(expected[part]),
        compiled=None if by_numba is None else watch.cpu_s(compiled) / own_s,
        bounds=bounds,
    )


def kernel_growths(watch: Stopwatch, samples: int) -> list[Growth]:
    """Return how the three grow with samples and plays."""
    found = []
    for stage, work in ((BANK, _bank), (FORWARD, _forward), (INVERSE, _inverse)):
        lengths = {samples // n: work(samples // n, 16) for n in PARTS}
        widths = {plays: work(samples // 4, plays) for plays in PLAYS}
        found.append(watch.grown(stage, "samples", lengths))
        found.append(watch.grown(stage, "plays", widths))
    return found


def _bank(samples: int, plays: int) -> Callable[[], object]:
    u_V = drive_V(samples)
    return lambda: bank(u_V, plays)


def _forward(samples: int, plays: int) -> Callable[[], object]:
    u_V, known = drive_V(samples), model(plays)
    return lambda: known.run(u_V, known.virgin_memory())


def _inverse(samples: int, plays: int) -> Callable[[], object]:
    known = model(plays)
    y_m, _ = known.run(drive_V(samples), known.virgin_memory())
    return lambda: known.inverse_run(y_m, known.virgin_memory())
