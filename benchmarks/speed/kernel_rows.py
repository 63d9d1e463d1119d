"""Play bank, model and inverse against loops, chains of min and max, and a copy."""

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
LOOP_SAMPLES = slice(0, 5000)  # of the NumPy loops
TOLERANCE = {"rtol": 1e-9, "atol": 1e-15}
WIDTHS = (4, 8, 16, 32, 64)


@dataclass(frozen=True, kw_only=True, eq=False)
class Kernel:
    """A function of piezoid, a NumPy loop for a slice of the samples, and compiled loops.

    compiled  by name; each returns None without numba
    """

    piezoid: Callable[[], Array]
    numpy_loop: Callable[[slice], Array]
    compiled: Mapping[str, Callable[[], Array | None]]


def kernel_rows(watch: Stopwatch, samples: int) -> list[Row]:
    """Return a row for each kernel, after a comparison of all results."""
    u_V = drive_V(samples)
    kernels = kernels_of(u_V)
    for kernel in kernels.values():
        compare(kernel)
    time_s = {stage: watch.cpu_s(kernel.piezoid) for stage, kernel in kernels.items()}
    bounds = bounds_of(watch, u_V, time_s)
    return [
        row_of(watch, stage, kernel, time_s[stage], bounds[stage])
        for stage, kernel in kernels.items()
    ]


def kernels_of(u_V: Array) -> dict[str, Kernel]:
    """Return the three kernels; the inverse receives the output of the model."""
    operator = model()
    memory = operator.virgin_memory()
    y_m, _ = operator.run(u_V, memory)
    return {
        BANK: Kernel(
            piezoid=lambda: bank(u_V),
            numpy_loop=lambda part: loops.numpy_bank(u_V[part], thresholds_V()),
            compiled={
                "numba": lambda: loops.numba_bank(u_V, thresholds_V(), "C"),
                "numba, in columns": lambda: loops.numba_bank(u_V, thresholds_V(), "F"),
            },
        ),
        FORWARD: Kernel(
            piezoid=lambda: operator.run(u_V, memory)[0],
            numpy_loop=lambda part: loops.numpy_forward(u_V[part], operator),
            compiled={"numba": lambda: loops.numba_forward(u_V, operator)},
        ),
        INVERSE: Kernel(
            piezoid=lambda: operator.inverse_run(y_m, memory)[0],
            numpy_loop=lambda part: loops.numpy_inverse(y_m[part], operator),
            compiled={"numba": lambda: loops.numba_inverse(y_m, operator)},
        ),
    }


def compare(kernel: Kernel) -> None:
    """Stop if the loops give other results."""
    expected = kernel.piezoid()
    looped = kernel.numpy_loop(LOOP_SAMPLES)
    np.testing.assert_allclose(looped, expected[LOOP_SAMPLES], **TOLERANCE)
    for compiled_loop in kernel.compiled.values():
        result = compiled_loop()
        if result is not None:
            np.testing.assert_allclose(result, expected, **TOLERANCE)


def bounds_of(
    watch: Stopwatch, u_V: Array, time_s: dict[str, float]
) -> dict[str, dict[str, float]]:
    """Return the times of the kernels over those of chains, of a copy, and of each other."""
    columns, work = bank(u_V), machine.chains(u_V, thresholds_V())
    target = columns.copy(order="F")
    bounds: dict[str, dict[str, float]] = {BANK: {}, FORWARD: {}, INVERSE: {}}
    if work is not None:
        np.testing.assert_array_equal(work(), columns[-1])
        chains_s = watch.cpu_s(work)
        for stage in (BANK, FORWARD):
            bounds[stage]["chains of min and max"] = time_s[stage] / chains_s
    copy_s = watch.cpu_s(lambda: np.copyto(target, columns))
    bounds[BANK]["copy of its columns"] = time_s[BANK] / copy_s
    bounds[INVERSE]["model forward"] = time_s[INVERSE] / time_s[FORWARD]
    return bounds


def row_of(
    watch: Stopwatch, stage: str, kernel: Kernel, time_s: float, bounds: dict[str, float]
) -> Row:
    """Return one row; the time of the NumPy loop is scaled to all samples."""
    expected = kernel.piezoid()
    share = len(expected[LOOP_SAMPLES]) / len(expected)
    return Row(
        stage=stage,
        loop=watch.cpu_s(lambda: kernel.numpy_loop(LOOP_SAMPLES)) / share / time_s,
        compiled={
            name: watch.cpu_s(work) / time_s
            for name, work in kernel.compiled.items()
            if work() is not None
        },
        bounds=bounds,
    )


def kernel_growths(watch: Stopwatch, samples: int) -> list[Growth]:
    """Return the growth of the kernels with samples and plays."""
    return growths(watch, {BANK: _bank, FORWARD: _forward, INVERSE: _inverse}, samples, WIDTHS)


def _bank(samples: int, plays: int) -> Callable[[], object]:
    u_V = drive_V(samples)
    return lambda: bank(u_V, plays)


def _forward(samples: int, plays: int) -> Callable[[], object]:
    u_V, operator = drive_V(samples), model(plays)
    return lambda: operator.run(u_V, operator.virgin_memory())


def _inverse(samples: int, plays: int) -> Callable[[], object]:
    operator = model(plays)
    y_m, _ = operator.run(drive_V(samples), operator.virgin_memory())
    return lambda: operator.inverse_run(y_m, operator.virgin_memory())
