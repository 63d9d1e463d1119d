"""Hysteresis classes and their inverses, fitted to one sweep.

    class                inverse
    Prandtl-Ishlinskii   closed form                            [Krejci & Kuhnen 2001]
    modified PI          closed form, dead zones behind plays   [Kuhnen 2003]
    generalised PI       closed form, envelope in front         [Al Janaideh, Rakheja & Su 2011]
    plays, functions     from bend to bend, as shipped          [Krejci 1996]
    Preisach             by table, along the branch             [Mayergoyz 1991]
    Bouc-Wen             multiplicative, without an inversion   [Rakotondrabe 2011]

A field is the drive scaled to -1 to 1. Every drive starts at -1, after a full cycle.
"""

import ctypes
import subprocess
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Protocol

import numpy as np
from scipy.optimize import least_squares, nnls

from benchmarks.recordings import recording_of
from piezoid.identification.hysteresis.coordinates import Shape, to_si_units
from piezoid.identification.hysteresis.pieces import Rig, pieces_of, scales_of
from piezoid.identification.hysteresis.search import Settings, search
from piezoid.identification.minor_loops_fit import SHAPES, fit_rises, lattice_of, rise_columns
from piezoid.numerics.arrays import Array
from piezoid.operators.play import play_columns
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii
from piezoid.operators.preisach_plays import PreisachPlays

FOLDER = Path(__file__).parent
BUILD = Path("build/rivals")
CYCLE = np.concatenate([np.linspace(-1.0, 1.0, 200), np.linspace(1.0, -1.0, 200)])
NODES, DEEPEST = 21, 64  # of the table, as in inverses.c
MIN_SLOPE = 0.2  # of the mean slope, right after a turning point; plays have 0.25 or more
PLAY_SHAPES = {
    "PI": Shape(plays=16, below=0, above=0, lag="none"),
    "MPI": Shape(plays=16, below=6, above=6, lag="none"),
    "GPI": Shape(plays=16, below=0, above=0, lag="none", bends=6),
    "MPI, envelope": Shape(plays=16, below=6, above=6, lag="none", bends=6),
}


class Model(Protocol):
    """A fitted hysteresis model."""

    parameters: int

    def forward(self, field: Array) -> Array:
        """Return the displacement along a drive from -1, (samples,)."""

    def inverse(self, displacement: Array) -> Array:
        """Return the fields from -1 that produce these displacements, (samples,)."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Plays:
    """Plays with or without dead zones and envelope."""

    operator: ModifiedPrandtlIshlinskii
    parameters: int

    @property
    def memory(self) -> Array:
        """Memory at -1 after a full cycle."""
        operator = self.operator
        return operator.run(np.tile(CYCLE, 2), operator.virgin_memory())[1]

    def forward(self, field: Array) -> Array:
        """Return the displacement along a drive from -1."""
        return self.operator.run(field, self.memory)[0]

    def inverse(self, displacement: Array) -> Array:
        """Return the fields from -1 that produce these displacements."""
        operator, memory, fields = self.operator, self.memory, []
        for sample in range(len(displacement)):
            field, _ = operator.inverse_run(displacement[sample : sample + 1], memory)
            field = np.clip(field, -1.0, 1.0)
            _, memory = operator.run(field, memory)  # the memory follows the limited field
            fields.append(field)
        return np.concatenate(fields)


def play_model(name: str, field: Array, displacement: Array) -> Plays:
    """Fit a class of plays with the search of piezoid."""
    recording = recording_of(field, displacement, 400.0)
    scales = scales_of([recording], "x")
    pieces = pieces_of([recording], "x", scales, Rig())
    settings = Settings(longest_lag_s=0.02, follow_zero=False, iterations=40)
    optimum = search(pieces, PLAY_SHAPES[name], settings)
    return Plays(
        operator=to_si_units(optimum.operator, scales), parameters=optimum.shape.parameters
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Functions:
    """Plays behind rising functions."""

    operator: PreisachPlays
    parameters: int

    @property
    def memory(self) -> Array:
        """Memory at -1 after a full cycle."""
        return self.operator.run(np.tile(CYCLE, 2), self.operator.at_rest(-1.0))[1]

    def forward(self, field: Array) -> Array:
        """Return the displacement along a drive from -1."""
        return self.operator.run(field, self.memory)[0]

    def inverse(self, displacement: Array) -> Array:
        """Return the fields from -1 that produce these displacements."""
        return np.clip(self.operator.inverse_run(displacement, self.memory)[0], -1.0, 1.0)


def function_model(field: Array, displacement: Array) -> Functions:
    """Fit the largest shape of plays behind functions, as the fit of a stage does."""
    lattice = lattice_of((-1.0, 1.0), SHAPES[-1])
    zero = lattice.virgin_memory()
    _, memory = play_columns(np.tile(CYCLE, 2), lattice.threshold_V, zero)
    states, _ = play_columns(field, lattice.threshold_V, memory)
    columns = np.stack(list(rise_columns(lattice, states)), axis=1)
    rows = np.column_stack([columns, displacement])
    rows -= rows.mean(axis=0)
    rises = fit_rises(rows.T @ rows, len(rows), lattice, float(np.ptp(displacement)))
    offset = float(np.mean(displacement - columns @ rises))
    operator = replace(lattice, displacement_offset_m=offset)
    operator = operator.with_rises(rises.reshape(lattice.rise_m.shape))
    return Functions(operator=operator, parameters=len(rises) + 1)


@cache
def library() -> ctypes.CDLL:
    """Compile the models without plays."""
    BUILD.mkdir(parents=True, exist_ok=True)
    path = (BUILD / "inverses.so").absolute()
    command = ("cc", "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
    subprocess.run((*command, str(FOLDER / "inverses.c"), "-o", str(path), "-lm"), check=True)
    code = ctypes.CDLL(str(path))
    for name in ("preisach_forward", "preisach_inverse", "bouc_wen_forward", "bouc_wen_inverse"):
        getattr(code, name).restype = ctypes.c_double
        getattr(code, name).argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
    code.preisach_start.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
    return code


class _Table(ctypes.Structure):
    _fields_ = (
        ("table", (ctypes.c_double * NODES) * NODES),
        ("low", ctypes.c_double),
        ("step", ctypes.c_double),
    )


class _TableState(ctypes.Structure):
    _fields_ = (
        ("depth", ctypes.c_int32),
        ("rises", ctypes.c_int32),
        ("field", ctypes.c_double),
        ("output", ctypes.c_double),
        ("turn", ctypes.c_double * DEEPEST),
        ("at", ctypes.c_double * DEEPEST),
    )


@dataclass(frozen=True, kw_only=True, eq=False)
class Preisach:
    """Increments of rising branches in a table, and the displacement at -1."""

    table: Array
    start: float
    parameters: int

    def _run(self, name: str, values: Array) -> Array:
        table = _Table(low=-1.0, step=2.0 / (NODES - 1))
        np.ctypeslib.as_array(table.table)[...] = self.table
        state, step = _TableState(), getattr(library(), name)
        addresses = ctypes.addressof(state), ctypes.addressof(table)
        library().preisach_start(*addresses, self.start)
        return np.array([step(*addresses, value) for value in values.tolist()])

    def forward(self, field: Array) -> Array:
        """Return the displacement along a drive from -1."""
        return self._run("preisach_forward", np.clip(field, -1.0, 1.0))

    def inverse(self, displacement: Array) -> Array:
        """Return the fields from -1 that produce these displacements."""
        return self._run("preisach_inverse", displacement)


def preisach_model(field: Array, displacement: Array) -> Preisach:
    """Fit a non-negative density on a triangle of 20 by 20 cells.

    y = y_0 + sum over the branches of +- T; every cell of the density is one column of T.
    """
    field = np.clip(field, -1.0, 1.0)
    step = 2.0 / (NODES - 1)
    edges = -1.0 + step * np.arange(NODES)
    upper, lower = np.tril_indices(NODES - 1)  # cells (a, b) with a >= b
    diagonal = upper == lower

    def increments(high: float, low: float) -> Array:
        rises = np.clip((high - edges[upper]) / step, 0.0, 1.0)
        falls = np.clip((edges[lower + 1] - low) / step, 0.0, 1.0)
        return np.where(diagonal, np.maximum(rises + falls - 1.0, 0.0), rises * falls)

    turn, at, rises = [float(field[0])], [np.zeros(len(upper))], True
    columns, previous = np.zeros((len(field), len(upper))), float(field[0])
    for k, value in enumerate(field.tolist()):
        if value != previous:
            if (value > previous) != rises:
                turn, at, rises = [*turn, previous], [*at, columns[k - 1]], value > previous
            while len(turn) > 1 and (value >= turn[-2] if rises else value <= turn[-2]):
                count = max(len(turn) - 2, 1)
                turn, at = turn[:count], at[:count]
            previous = value
        sign = 1.0 if rises else -1.0
        columns[k] = at[-1] + sign * increments(max(value, turn[-1]), min(value, turn[-1]))
    min_weight = MIN_SLOPE * step * float(np.ptp(displacement)) / 2.0 * diagonal
    constant = np.ones((len(field), 1))
    remainder = displacement - columns @ min_weight - displacement.min()
    solution, _ = nnls(np.hstack([columns, constant, -constant]), remainder)
    weight = solution[:-2] + min_weight
    table = np.zeros((NODES, NODES))
    for a in range(NODES):
        for b in range(a):
            table[a, b] = weight[(upper < a) & (lower >= b)].sum()
    start = float(displacement.min() + solution[-2] - solution[-1])
    return Preisach(table=table, start=start, parameters=len(upper) + 1)


class _BoucWen(ctypes.Structure):
    _fields_ = tuple(
        (name, ctypes.c_double) for name in ("c", "d", "gamma", "beta", "exponent", "share")
    )


class _BoucWenState(ctypes.Structure):
    _fields_ = (("field", ctypes.c_double), ("z", ctypes.c_double))


@dataclass(frozen=True, kw_only=True, eq=False)
class BoucWen:
    """y = c + d u - share z, with the inverse multiplicative structure."""

    numbers: tuple[float, ...]
    parameters: int = 6

    def _run(self, name: str, values: Array) -> Array:
        state, step = _BoucWenState(field=-1.0, z=0.0), getattr(library(), name)
        numbers = _BoucWen(*self.numbers)
        addresses = ctypes.addressof(state), ctypes.addressof(numbers)
        for field in np.tile(CYCLE, 2).tolist():
            library().bouc_wen_forward(*addresses, field)
        return np.array([step(*addresses, value) for value in values.tolist()])

    def forward(self, field: Array) -> Array:
        """Return the displacement along a drive from -1."""
        return self._run("bouc_wen_forward", field)

    def inverse(self, displacement: Array) -> Array:
        """Return the fields from -1 that produce these displacements."""
        return self._run("bouc_wen_inverse", displacement)


def bouc_wen_model(field: Array, displacement: Array) -> BoucWen:
    """Fit gamma, beta and exponent; the linear parameters c, d and share follow."""

    def linear(shape: Array) -> tuple[Array, Array]:
        gamma, beta, exponent = np.exp(shape[0]) * shape[1], np.exp(shape[0]), np.exp(shape[2])
        z = BoucWen(numbers=(0.0, 0.0, gamma, beta, exponent, -1.0)).forward(field)
        columns = np.stack([np.ones_like(field), field, -z], axis=1)
        coefficients = np.linalg.lstsq(columns, displacement, rcond=None)[0]
        return coefficients, columns @ coefficients - displacement

    bounds = ([-3.0, -0.9, 0.0], [5.0, 0.9, 1.5])
    fits = [
        least_squares(lambda x: linear(x)[1], start, bounds=bounds, diff_step=1e-3, max_nfev=25)
        for start in ([0.5, 0.0, 0.1], [2.0, -0.3, 0.4])
    ]
    shape = min(fits, key=lambda fit: fit.cost).x
    (c, d, share), _ = linear(shape)
    gamma, beta, exponent = np.exp(shape[0]) * shape[1], np.exp(shape[0]), np.exp(shape[2])
    return BoucWen(numbers=tuple(map(float, (c, d, gamma, beta, exponent, share))))


FITS = {
    **{name: partial(play_model, name) for name in PLAY_SHAPES},
    "plays, functions": function_model,
    "Preisach": preisach_model,
    "Bouc-Wen": bouc_wen_model,
}
