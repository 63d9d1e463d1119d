"""How fast the kernels are, as ratios within one run: against loops, general solvers, the machine.

    python benchmarks/ratios.py [SAMPLES]

Every time is processor time of this process, so that a busy machine does not enter; set
OPENBLAS_NUM_THREADS=1. 16 plays and 6 + 6 dead zones; one row for each comparison. How the
kernels grow is the slope of log time over log samples and over log plays.
"""

import sys
import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import lsq_linear, nnls

from piezoid.numerics.arrays import Array
from piezoid.numerics.quadratic_program import bounded_step
from piezoid.numerics.triangle import empty_triangle, gather
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.modified_prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import PrandtlIshlinskii

PLAYS = 16
LOOPED = 5_000  # samples of the NumPy loop; it is slow


def cpu_s(work: Callable[[], object], repeats: int = 3) -> float:
    """Return the least processor time of a few runs."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def drive(samples: int) -> Array:
    """A sine that swells and falls: loops at all levels."""
    t = np.linspace(0.0, 1.0, samples)
    return np.asarray(5 * (0.05 + 0.95 * np.abs(np.cos(9 * t))) * np.sin(400 * t))


def thresholds(plays: int) -> Array:
    """Return evenly spread thresholds, none of them 0."""
    return np.asarray(np.arange(1, plays + 1) * (4.8 / plays))


def bank(u: Array, plays: int = PLAYS) -> Array:
    """Return the states of the plays by the kernel."""
    return play_columns(u, thresholds(plays), np.zeros(plays))[0]


def loop(u: Array) -> Array:
    """Return them by the definition, sample by sample, all plays at once."""
    r, z = thresholds(PLAYS), np.zeros(PLAYS)
    columns = np.empty((len(u), PLAYS))
    for k, value in enumerate(u):
        z = np.minimum(np.maximum(z, value - r), value + r)
        columns[k] = z
    return columns


def model() -> ModifiedPrandtlIshlinskii:
    """Return an operator of 16 moving plays and 12 dead zones."""
    side = np.concatenate([np.linspace(0.9, 0.98, 6), [1.0, 1.0], np.linspace(0.98, 0.9, 6)])
    return ModifiedPrandtlIshlinskii(
        plays=PrandtlIshlinskii(
            threshold=np.concatenate([[0.0], thresholds(PLAYS)]),
            weight=np.concatenate([[2e-6], np.full(PLAYS, 1e-7)]),
        ),
        dead_zones=from_slopes(np.linspace(-12e-6, 12e-6, 13), side),
        voltage_offset_V=0.0,
        displacement_offset_m=0.0,
    )


def growth(work: Callable[[int], object], sizes: tuple[int, ...]) -> float:
    """Return the exponent with which the time grows."""
    times = [cpu_s(lambda size=size: work(size)) for size in sizes]  # type: ignore[misc]
    return float(np.polyfit(np.log(sizes), np.log(times), 1)[0])


def by_triangle(columns: Array, target: Array) -> Array:
    """Return non-negative weights by way of the triangle, gathered in blocks."""
    triangle = empty_triangle(columns.shape[1] + 1)
    for k in range(0, len(columns), 4096):
        part = slice(k, k + 4096)
        triangle = gather(triangle, np.column_stack([columns[part], target[part]]))
    unknowns = columns.shape[1]
    limits = np.zeros(unknowns), np.full(unknowns, np.inf)
    return bounded_step(triangle[:, :-1], triangle[:, -1], *limits)


def main() -> None:
    """Print the table."""
    samples = int(sys.argv[1]) if len(sys.argv) > 1 else 200_000
    u, found = drive(samples), model()
    columns = bank(u)
    np.testing.assert_array_equal(columns[:LOOPED], loop(u[:LOOPED]))
    truth = np.linspace(1.0, 0.1, PLAYS)
    truth[::5] = 0.0
    target = columns @ truth + 0.01 * np.random.default_rng(1).standard_normal(samples)
    wall = columns.copy(order="F")
    bank_s = cpu_s(lambda: bank(u))
    copy_s = cpu_s(lambda: np.copyto(wall, columns))
    loop_s = cpu_s(lambda: loop(u[:LOOPED]), 1) * samples / LOOPED
    rest = found.virgin_memory()
    y, _ = found.run(u, rest)
    forward_s = cpu_s(lambda: found.run(u, rest))
    inverse_s = cpu_s(lambda: found.inverse_run(y, rest))
    triangle_s = cpu_s(lambda: by_triangle(columns, target))
    nnls_s = cpu_s(lambda: nnls(columns, target), 1)
    bounded_s = cpu_s(lambda: lsq_linear(columns, target, (0.0, np.inf), method="bvls"), 1)
    apart = np.abs(by_triangle(columns, target) - nnls(columns, target)[0]).max()
    print(f"play bank: {1e9 * bank_s / samples / PLAYS:.2f} ns a play and sample")
    for name, ratio in (
        ("NumPy loop / play bank", loop_s / bank_s),
        ("play bank / copy of its own columns (memory's limit)", bank_s / copy_s),
        ("model forward / play bank", forward_s / bank_s),
        ("inverse / model forward", inverse_s / forward_s),
        ("scipy nnls on all rows / weights by the triangle", nnls_s / triangle_s),
        ("scipy lsq_linear on all rows / weights by the triangle", bounded_s / triangle_s),
    ):
        print(f"{name}: {ratio:.2g}")
    print(f"largest difference of the weights to nnls: {apart:.1e}")
    sizes = (samples // 8, samples // 4, samples // 2, samples)
    print(f"play bank over samples: exponent {growth(lambda n: bank(drive(n)), sizes):.2f}")
    print(f"play bank over plays: exponent {growth(lambda n: bank(u, n), (8, 16, 32, 64)):.2f}")


if __name__ == "__main__":
    main()
