"""Weights, Kuhnen's program and the search for one shape: against general solvers on all rows."""

from collections.abc import Callable

import numpy as np

from benchmarks.speed import solvers
from benchmarks.speed.drives import PLAYS, ZONES, bank, drive_V, noisy_sum, piece_of, program_of
from benchmarks.speed.growths import growths
from benchmarks.speed.stopwatch import Growth, Stopwatch
from benchmarks.speed.table import Row
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.gauss_newton import minimise, rms_of

WEIGHTS, TRIANGLE = "weights of the plays, from all rows", "weights on the triangle"
PROGRAM, SHAPE = "Kuhnen's program", "fit of one shape"
SAME_TRIANGLE = 1e-9  # of the largest weight; R'R knows no more
SAME = 1e-4  # of the largest weight: an interior-point solver stops there
AS_GOOD = 1.02  # how much more a search by differences may leave
WIDTHS = (4, 8, 16, 32)


def weights_row(watch: Stopwatch, samples: int) -> Row:
    """Return non-negative weights of 16 plays, solved again by SciPy and cvxpy."""
    columns = bank(drive_V(samples))
    target = noisy_sum(columns)
    found, own_s = (
        solvers.weights(columns, target),
        watch.cpu_s(lambda: solvers.weights(columns, target)),
    )
    others = solvers.weights_by_others(columns, target)
    for solve in others.values():
        np.testing.assert_allclose(solve(), found, atol=SAME * found.max())
    return Row(
        stage=WEIGHTS,
        solvers={name: watch.cpu_s(solve) / own_s for name, solve in others.items()},
        bounds={"product R'R by BLAS": own_s / watch.cpu_s(lambda: columns.T @ columns)},
    )


def triangle_row(watch: Stopwatch, samples: int) -> Row:
    """Return the same weights from their triangle alone, by solvers that are given no more."""
    columns = bank(drive_V(samples))
    triangle = solvers.triangle_of(np.column_stack([columns, noisy_sum(columns)]))
    found = solvers.on_triangle(triangle)
    own_s = watch.cpu_s(lambda: solvers.on_triangle(triangle))
    others = solvers.on_triangle_by_others(triangle)
    for solve in others.values():
        np.testing.assert_allclose(solve(), found, atol=SAME_TRIANGLE * found.max())
    return Row(
        stage=TRIANGLE,
        solvers={name: watch.cpu_s(solve) / own_s for name, solve in others.items()},
    )


def program_row(watch: Stopwatch, samples: int) -> Row:
    """Return Kuhnen's program of 16 plays and 12 dead zones, solved again by cvxpy."""
    program = program_of(piece_of(samples))
    found, own_s = solvers.kuhnen(program), watch.cpu_s(lambda: solvers.kuhnen(program))
    again = solvers.kuhnen_by_cvxpy(program)
    np.testing.assert_allclose(again, found, atol=SAME * np.abs(found).max())
    return Row(
        stage=PROGRAM,
        solvers={"cvxpy": watch.cpu_s(lambda: solvers.kuhnen_by_cvxpy(program)) / own_s},
        bounds={"product R'R by BLAS": own_s / watch.cpu_s(lambda: program.rows.T @ program.rows)},
    )


def shape_row(watch: Stopwatch, samples: int) -> Row:
    """Return Gauss-Newton on all numbers of a shape, searched again by scipy's trust region."""
    theta, task = solvers.begun(piece_of(samples), shape_of(PLAYS))
    own, own_s = (
        minimise(theta, task, iterations=30),
        watch.cpu_s(lambda: minimise(theta, task, iterations=30)),
    )
    again = solvers.by_least_squares(theta, task)
    if not own.rms < AS_GOOD * again:
        raise AssertionError(f"ours leaves {own.rms:.4g}, scipy {again:.4g}")
    return Row(
        stage=SHAPE,
        solvers={
            "least_squares": watch.cpu_s(lambda: solvers.by_least_squares(theta, task)) / own_s
        },
        bounds={"forward runs": own_s / watch.cpu_s(lambda: rms_of(theta, task))},
    )


def shape_of(plays: int) -> Shape:
    """Return a shape of so many plays, without a lag."""
    return Shape(plays=plays, below=ZONES, above=ZONES, lag="none")


def program_growths(watch: Stopwatch, samples: int) -> list[Growth]:
    """Return how the three grow with samples and plays."""
    return growths(watch, {WEIGHTS: _weights, PROGRAM: _program, SHAPE: _shape}, samples, WIDTHS)


def _weights(samples: int, plays: int) -> Callable[[], object]:
    columns = bank(drive_V(samples), plays)
    target = noisy_sum(columns)
    return lambda: solvers.weights(columns, target)


def _program(samples: int, plays: int) -> Callable[[], object]:
    program = program_of(piece_of(samples), plays)
    return lambda: solvers.kuhnen(program)


def _shape(samples: int, plays: int) -> Callable[[], object]:
    theta, task = solvers.begun(piece_of(samples), shape_of(plays))
    return lambda: minimise(theta, task, iterations=30)
