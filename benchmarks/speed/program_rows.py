"""Weights, Kuhnen's program and the fit of one shape against general solvers on all rows."""

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
TRIANGLE_TOLERANCE = 1e-9  # of the largest weight, the precision of R'R
TOLERANCE = 1e-4  # of the largest weight, the precision of an interior-point solver
MAX_RATIO = 1.02  # of the residuals of piezoid and of a search by differences
WIDTHS = (4, 8, 16, 32)


def weights_row(watch: Stopwatch, samples: int) -> Row:
    """Compare the non-negative weights of 16 plays with SciPy and cvxpy."""
    columns = bank(drive_V(samples))
    target = noisy_sum(columns)
    weights = solvers.weights(columns, target)
    time_s = watch.cpu_s(lambda: solvers.weights(columns, target))
    general = solvers.general_weights(columns, target)
    for solve in general.values():
        np.testing.assert_allclose(solve(), weights, atol=TOLERANCE * weights.max())
    return Row(
        stage=WEIGHTS,
        solvers={name: watch.cpu_s(solve) / time_s for name, solve in general.items()},
        bounds={"product R'R by BLAS": time_s / watch.cpu_s(lambda: columns.T @ columns)},
    )


def triangle_row(watch: Stopwatch, samples: int) -> Row:
    """Compare the same weights, computed from the triangle, with solvers of small problems."""
    columns = bank(drive_V(samples))
    triangle = solvers.triangle_of(np.column_stack([columns, noisy_sum(columns)]))
    weights = solvers.on_triangle(triangle)
    time_s = watch.cpu_s(lambda: solvers.on_triangle(triangle))
    general = solvers.general_on_triangle(triangle)
    for solve in general.values():
        np.testing.assert_allclose(solve(), weights, atol=TRIANGLE_TOLERANCE * weights.max())
    return Row(
        stage=TRIANGLE,
        solvers={name: watch.cpu_s(solve) / time_s for name, solve in general.items()},
    )


def program_row(watch: Stopwatch, samples: int) -> Row:
    """Compare Kuhnen's program of 16 plays and 12 dead zones with cvxpy."""
    program = program_of(piece_of(samples))
    optimum, time_s = solvers.kuhnen(program), watch.cpu_s(lambda: solvers.kuhnen(program))
    tolerance = TOLERANCE * np.abs(optimum).max()
    np.testing.assert_allclose(solvers.kuhnen_by_cvxpy(program), optimum, atol=tolerance)
    product_s = watch.cpu_s(lambda: program.rows.T @ program.rows)
    return Row(
        stage=PROGRAM,
        solvers={"cvxpy": watch.cpu_s(lambda: solvers.kuhnen_by_cvxpy(program)) / time_s},
        bounds={"product R'R by BLAS": time_s / product_s},
    )


def shape_row(watch: Stopwatch, samples: int) -> Row:
    """Compare Gauss-Newton on all parameters of a shape with the trust region of SciPy."""
    theta, task = solvers.start_of(piece_of(samples), shape_of(PLAYS))
    rms = minimise(theta, task, iterations=30).rms
    time_s = watch.cpu_s(lambda: minimise(theta, task, iterations=30))
    scipy_rms = solvers.by_least_squares(theta, task)
    if not rms < MAX_RATIO * scipy_rms:
        raise AssertionError(f"residual of piezoid {rms:.4g}, of scipy {scipy_rms:.4g}")
    scipy_s = watch.cpu_s(lambda: solvers.by_least_squares(theta, task))
    return Row(
        stage=SHAPE,
        solvers={"least_squares": scipy_s / time_s},
        bounds={"forward runs": time_s / watch.cpu_s(lambda: rms_of(theta, task))},
    )


def shape_of(plays: int) -> Shape:
    """Return a shape with a number of plays, without a lag."""
    return Shape(plays=plays, below=ZONES, above=ZONES, lag="none")


def program_growths(watch: Stopwatch, samples: int) -> list[Growth]:
    """Return the growth of weights, program and fit with samples and plays."""
    return growths(watch, {WEIGHTS: _weights, PROGRAM: _program, SHAPE: _shape}, samples, WIDTHS)


def _weights(samples: int, plays: int) -> Callable[[], object]:
    columns = bank(drive_V(samples), plays)
    target = noisy_sum(columns)
    return lambda: solvers.weights(columns, target)


def _program(samples: int, plays: int) -> Callable[[], object]:
    program = program_of(piece_of(samples), plays)
    return lambda: solvers.kuhnen(program)


def _shape(samples: int, plays: int) -> Callable[[], object]:
    theta, task = solvers.start_of(piece_of(samples), shape_of(plays))
    return lambda: minimise(theta, task, iterations=30)
