"""The Bouc-Wen benchmark: one mode whose restoring force has a smooth hysteresis.

J.P. Noel & M. Schoukens, Hysteretic benchmark with a dynamic nonlinearity, Workshop on Nonlinear
System Identification Benchmarks, Brussels 2016; data doi 10.4121/12967592, CC BY-SA 4.0.

The folder contains train_data.csv.gz (y m, u N; 750 Hz) and {u,y}val_{multisine,sinesweep}.mat.
The training data are five periods of 8192 samples of a multisine of 5 to 150 Hz and 50 N rms, with
noise of about 7.3e-6 m on y.
"""

import csv
import gzip
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares
from scipy.signal import lfilter

from benchmarks.records.bouc_wen.fit import fit
from benchmarks.records.bouc_wen.mode import BoucWenMode

NAME = "bouc_wen"
FOLDER = "boucwen_benchmark"
RATE_HZ = 750.0
PERIOD = 8192

Simulation = Callable[[np.ndarray, bool], np.ndarray]

PROTOCOL = """Bouc-Wen benchmark (Noel & Schoukens 2016; doi 10.4121/12967592)
All parameters and the initial state are fitted to the training record (40,960 samples with noise).
The force is band-limited between the samples and integrated with the number of steps below. The
displacement has no decimation filter, unlike that of the publishers. Multisine: rms over the 8192
samples of the last of five simulated periods. Sweep: rms over all 153,000 samples, from rest."""

# rms on the multisine, m. Their authors did not report the sweep, or not on these samples.
PUBLISHED = (
    ("polynomial nonlinear state space, the best", 1.2e-5),
    ("polynomial nonlinear state space, another", 5.4e-5),
    ("sparse identification (SINDy)", 1.8e-4),
    ("linear", 1.7e-4),
)


@dataclass(frozen=True, kw_only=True)
class Row:
    """Error of one method; None if it was not run, infinite if it diverged."""

    method: str
    multisine_m: float
    sweep_m: float | None
    training_s: float | None


def training(folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return force (N) and displacement of the training record."""
    with gzip.open(folder / "train_data.csv.gz", "rt", encoding="ascii", newline="") as file:
        rows = [(float(row["u"]), float(row["y"])) for row in csv.DictReader(file)]
    force, motion_m = np.array(rows).T
    return np.ascontiguousarray(force), np.ascontiguousarray(motion_m)


def validation(folder: Path, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return force (N) and displacement of ``multisine`` or ``sinesweep``."""
    columns = []
    for letter in "uy":
        variables = loadmat(folder / f"{letter}val_{name}.mat")
        (values,) = (value for key, value in variables.items() if not key.startswith("__"))
        columns.append(np.ascontiguousarray(values.ravel(), dtype=np.float64))
    return columns[0], columns[1]


def true_mode() -> BoucWenMode:
    """Return the mode with the parameters of the publishers, a lower limit of all errors."""
    size_m = 1e-3
    return BoucWenMode(
        mass=2.0, damping=10.0, stiffness=5e4, quadratic=0.0, cubic=0.0, spring_stiffness=5e4,
        beta=0.8 * 1e3 * size_m, gamma=-1.1 * 1e3 * size_m, exponent=1.0, bias=0.0, size_m=size_m,
    )  # fmt: skip


def linear(force: np.ndarray, motion_m: np.ndarray) -> Simulation:
    """Fit a discrete transfer function of order four by its output error, with scipy."""
    order, size = 4, motion_m.std()
    columns = [np.roll(motion_m, lag) / size for lag in range(1, order + 1)]
    columns += [np.roll(force, lag) for lag in range(order + 1)]
    start = np.linalg.lstsq(np.column_stack(columns)[order:], motion_m[order:] / size, rcond=None)

    def simulate(x: np.ndarray, u: np.ndarray) -> np.ndarray:
        return size * lfilter(x[order:], np.concatenate([[1.0], -x[:order]]), u)

    def error(x: np.ndarray) -> np.ndarray:
        return np.clip(np.nan_to_num((simulate(x, force) - motion_m) / size), -1e3, 1e3)

    best = least_squares(error, start[0], x_scale="jac").x

    def run(u: np.ndarray, periodic: bool) -> np.ndarray:
        return simulate(best, np.tile(u, 3) if periodic else u)[-len(u) :]

    return run


def sparse(force: np.ndarray, motion_m: np.ndarray) -> Simulation | None:
    """Fit y[k+1] = cubic polynomial of y[k], y[k-1], u[k+1], u[k], u[k-1] with pysindy.

    The threshold is the one of four with the smallest simulation error on the training record.
    """
    try:
        import pysindy
    except ImportError:
        return None
    force_rms, size = force.std(), motion_m.std()
    y, u = motion_m / size, force / force_rms
    states, next_states = np.column_stack([y[1:-1], y[:-2]]), np.column_stack([y[2:], y[1:-1]])
    inputs = np.column_stack([u[2:], u[1:-1], u[:-2]])

    def fit_with(threshold: float) -> Simulation:
        model = pysindy.DiscreteSINDy(
            optimizer=pysindy.STLSQ(threshold=threshold, alpha=0.0),
            feature_library=pysindy.PolynomialLibrary(degree=3),
        )
        model.fit(states, u=inputs, x_next=next_states, t=1)
        weights = model.coefficients()[0]
        nonzero = np.flatnonzero(weights)
        powers, weights = model.feature_library.powers_[nonzero], weights[nonzero]

        def run(drive: np.ndarray, periodic: bool) -> np.ndarray:
            v = (np.tile(drive, 2) if periodic else drive) / force_rms
            output = np.zeros(len(v))
            for k in range(2, len(v)):
                features = np.array([output[k - 1], output[k - 2], v[k], v[k - 1], v[k - 2]])
                output[k] = weights @ np.prod(features**powers, axis=1)
                if not abs(output[k]) < 1e3:
                    output[k:] = np.inf
                    break
            return size * output[-len(drive) :]

        return run

    candidates = [fit_with(threshold) for threshold in (1e-3, 3e-3, 1e-2, 3e-2)]
    return min(candidates, key=lambda run: rms(run(force, False) - motion_m))


def rms(error: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(error**2)))


def report(folder: Path) -> Iterator[str]:
    """Yield the lines of the table."""
    yield PROTOCOL
    force, motion_m = training(folder)
    multisine, sweep = validation(folder, "multisine"), validation(folder, "sinesweep")

    def evaluate(method: str, run: Simulation, training_s: float | None) -> Row:
        return Row(
            method=method,
            multisine_m=rms(run(multisine[0], True) - multisine[1]),
            sweep_m=rms(run(sweep[0], False) - sweep[1]),
            training_s=training_s,
        )

    def simulation_of(mode: BoucWenMode) -> Simulation:
        return lambda u, periodic: mode.simulate(u, RATE_HZ, periodic=periodic)

    start_s = time.process_time()
    identified = fit(force, motion_m, RATE_HZ)
    training_s = time.process_time() - start_s
    rows = [evaluate("mode with a Bouc-Wen spring", simulation_of(identified.mode), training_s)]
    methods = (("linear, order 4 (scipy)", linear), ("SINDy, cubic (pysindy)", sparse))
    for method, train in methods:
        start_s = time.process_time()
        run = train(force, motion_m)
        training_s = time.process_time() - start_s
        if run is None:
            yield f"{method}: skipped without the package; install the extra 'benchmarks'"
            continue
        rows.append(evaluate(method, run, training_s))
    rows.append(evaluate("true equations and parameters", simulation_of(true_mode()), None))
    rows += [
        Row(method=f"published: {method}", multisine_m=value, sweep_m=None, training_s=None)
        for method, value in PUBLISHED
    ]
    yield f"integration: {identified.mode.steps(RATE_HZ)} Runge-Kutta steps per sample"
    yield f"training record: residual {identified.residual_rms_m:.3g} m rms"
    for name, (low, high) in identified.interval.items():
        yield f"{name}: {low:.6g} to {high:.6g}"
    yield ""
    yield "| method | multisine, rms m | sweep, rms m | training, s of one core |"
    yield "| --- | --- | --- | --- |"
    for row in rows:
        sweep_text = "" if row.sweep_m is None else f"{row.sweep_m:.2e}"
        training_text = "" if row.training_s is None else f"{row.training_s:.0f}"
        yield f"| {row.method} | {row.multisine_m:.2e} | {sweep_text} | {training_text} |"
