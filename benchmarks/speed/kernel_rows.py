"""Play bank, model and inverse: against loops, chains of min and max, and a copy."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from benchmarks.speed import loops, machine
from benchmarks.speed.drives import bank, drive_V, model, thresholds_V
from benchmarks.speed.growths import growths
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row
from piezoid.numerics.arrays import Array

BANK, FORWARD, INVERSE = "play bank", "model forward", "inverse"
LOOPED = slice(0, 5000)  # samples of the NumPy loops, which are slow
CLOSE = {"rtol": 1e-9, "atol": 1e-15}
WIDTHS = (4, 8, 16, 32, 64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Kernel:
    """One stage, the same as a NumPy loop over some samples, and by compiled loops.

    compiled  by name; each returns None where this machine has no such compiler
    """

    ours: Callable[[], Array]
    looped: Callable[[slice], Array]
    compiled: Mapping[str, Callable[[], Array | None]]


def kernel_rows(watch: Stopwatch, samples: int) -> list[Row]:
    """Return a row each, all results compared before they are timed."""
    u_V = drive_V(samples)
    kernels = kernels_of(u_V)
    for one in kernels.values():
        compare(one)
    own_s = {stage: watch.cpu_s(one.ours) for stage, one in kernels.items()}
    bounds = bounds_of(watch, u_V, own_s)
    return [row_of(watch, stage, kernels[stage], own_s[stage], bounds[stage]) for stage in kernels]


def kernels_of(u_V: Array) -> dict[str, Kernel]:
    """Return the three with their rivals; the inverse is asked for what the model makes."""
    known = model()
    rest = known.virgin_memory()
    y_m, _ = known.run(u_V, rest)
    return {
        BANK: Kernel(
            ours=lambda: bank(u_V),
            looped=lambda part: loops.numpy_bank(u_V[part], thresholds_V()),
            compiled={
                "numba": lambda: loops.numba_bank(u_V, thresholds_V(), "C"),
                "numba, in columns": lambda: loops.numba_bank(u_V, thresholds_V(), "F"),
                "C": lambda: machine.c_bank(u_V, thresholds_V()),
            },
        ),
        FORWARD: Kernel(
            ours=lambda: known.run(u_V, rest)[0],
            looped=lambda part: loops.numpy_forward(u_V[part], known),
            compiled={
                "numba": lambda: loops.numba_forward(u_V, known),
                "C": lambda: machine.c_forward(u_V, known),
            },
        ),
        INVERSE: Kernel(
            ours=lambda: known.inverse_run(y_m, rest)[0],
            looped=lambda part: loops.numpy_inverse(y_m[part], known),
            compiled={
                "numba": lambda: loops.numba_inverse(y_m, known),
                "C": lambda: machine.c_inverse(y_m, known),
            },
        ),
    }


def compare(kernel: Kernel) -> None:
    """Stop unless the loops' results are ours."""
    expected = kernel.ours()
    np.testing.assert_allclose(kernel.looped(LOOPED), expected[LOOPED], **CLOSE)
    for again in kernel.compiled.values():
        found = again()
        if found is not None:
            np.testing.assert_allclose(found, expected, **CLOSE)


def bounds_of(
    watch: Stopwatch, u_V: Array, own_s: dict[str, float]
) -> dict[str, dict[str, float]]:
    """Return how many times as long as chains, as a copy, as one another the three take."""
    columns, work = bank(u_V), machine.chains(u_V, thresholds_V())
    wall = columns.copy(order="F")
    found: dict[str, dict[str, float]] = {BANK: {}, FORWARD: {}, INVERSE: {}}
    if work is not None:
        np.testing.assert_array_equal(work(), columns[-1])
        chains_s = watch.cpu_s(work)
        for stage in (BANK, FORWARD):
            found[stage]["chains of min and max"] = own_s[stage] / chains_s
    copy_s = watch.cpu_s(lambda: np.copyto(wall, columns))
    found[BANK]["copy of its columns"] = own_s[BANK] / copy_s
    found[INVERSE]["model forward"] = own_s[INVERSE] / own_s[FORWARD]
    return found


def row_of(
    watch: Stopwatch, stage: str, kernel: Kernel, own_s: float, bounds: dict[str, float]
) -> Row:
    """Return one row; the NumPy loop's time is that of as many samples as ours."""
    expected = kernel.ours()
    share = len(expected[LOOPED]) / len(expected)
    return Row(
        stage=stage,
        loop=watch.cpu_s(lambda: kernel.looped(LOOPED)) / share / own_s,
        compiled={
            name: watch.cpu_s(work) / own_s
            for name, work in kernel.compiled.items()
            if work() is not None
        },
        bounds=bounds,
    )


def kernel_growths(watch: Stopwatch, samples: int) -> list[Growth]:
    """Return how the three grow with samples and plays."""
    return growths(watch, {BANK: _bank, FORWARD: _forward, INVERSE: _inverse}, samples, WIDTHS)


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
