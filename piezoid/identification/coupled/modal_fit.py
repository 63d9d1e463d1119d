"""Least squares of the modal sum over all levels by variable projection.

    minimise  sum_r w_r |e^(j w delay) Y_r - G(s, l) U_r|^2,     G linear in its residues

The residues of all outputs meet the same rows, so one matrix of (columns x inputs) is factored
for all of them. The Jacobian is in the form of Kaufman [Golub & Pereyra 1973]. A pole that no
residue needs moves anywhere within its bounds.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from piezoid.identification.coupled.coupled_stage import Columns, ModalShape, level_coordinate
from piezoid.identification.dynamics.periodic_estimate import PeriodicData
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise

MAX_DAMPING = 0.3  # of a mode: a pole with more follows a slope
# Share of the curvature that penalises the change of a residue with the level: 1e-2 and 1e-3 leave
# the same residual on the steering mirror; without it those of overlapping modes diverge.
LEVEL_PENALTY = 1e-3
RIDGE = 1e-9  # of the curvature: columns that the band does not distinguish


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelSpectra:
    """Spectra at the excited lines of one level, means over the periods.

    level_V       rms of the drive
    samples       of one period
    frequency_Hz  (lines,)
    drive         (lines, inputs, realisations)   of ``numpy.fft.rfft``
    displacement         (lines, outputs, realisations)
    weight        (realisations,)
    """

    level_V: float
    samples: int
    frequency_Hz: Array
    drive: ComplexArray
    displacement: ComplexArray
    weight: Array

    @staticmethod
    def of(data: PeriodicData) -> "LevelSpectra":
        """Return the spectra of periodic data, each realisation weighted by its power."""
        lines = data.excited_lines()
        response = np.fft.rfft(data.displacement_m.mean(axis=3), axis=0)[lines]
        return LevelSpectra(
            level_V=float(data.voltage_V.std()),
            samples=len(data.voltage_V),
            frequency_Hz=data.frequency_Hz(lines),
            drive=np.fft.rfft(data.voltage_V.mean(axis=3), axis=0)[lines],
            displacement=response,
            weight=1.0 / (np.abs(response) ** 2).sum(axis=(0, 1)),
        )

    def without(self, realisation: int) -> "LevelSpectra":
        """Return the spectra of all realisations but one."""
        remaining = np.arange(len(self.weight)) != realisation
        return replace(
            self,
            drive=self.drive[..., remaining],
            displacement=self.displacement[..., remaining],
            weight=self.weight[remaining],
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalProblem:
    """The spectra of all levels and the structure that is fitted to them.

    levels    in increasing order
    rate_Hz   sampling rate
    lag_Hz    (lags,)  corner frequencies of real poles, fixed
    modes     number of complex pairs
    """

    levels: tuple[LevelSpectra, ...]
    rate_Hz: float
    lag_Hz: Array
    modes: int

    @property
    def levels_V(self) -> Array:
        """Rms of the drive at each level, (levels,)."""
        return np.array([level.level_V for level in self.levels])

    @property
    def orders(self) -> int:
        """1 where all data have one level, 2 where parameters change with it."""
        return 1 if len(self.levels) == 1 else 2

    def coordinate(self, level: LevelSpectra) -> float:
        """Return the position of a level between the smallest, -1, and the largest, 1."""
        return level_coordinate(level.level_V, self.levels_V)

    def pack(self, shape: ModalShape) -> Array:
        """Return the parameter vector of a shape."""
        poles = np.stack([shape.log_frequency, shape.log_damping], axis=1)[: self.orders]
        return np.append(poles.ravel(), shape.delay_s * self.rate_Hz)

    def unpack(self, x: Array) -> ModalShape:
        """Return the shape of a parameter vector."""
        poles = np.zeros((2, 2, self.modes))
        poles[: self.orders] = x[:-1].reshape(self.orders, 2, self.modes)
        return ModalShape(
            log_frequency=poles[:, 0],
            log_damping=poles[:, 1],
            delay_s=float(x[-1]) / self.rate_Hz,
        )

    def bounds(self, start: Array) -> tuple[Array, Array, Array]:
        """Return lower and upper bounds and the longest step: no pole jumps over its neighbour."""
        count = len(start) - 1
        reach = np.append(np.repeat([0.2, 3.0, 0.05, 1.0], self.modes)[:count], 10.0)
        longest = np.append(np.tile(np.repeat([0.03, 0.4], self.modes), self.orders), 0.3)
        upper = start + reach
        upper[self.modes : 2 * self.modes] = np.log(MAX_DAMPING)
        return np.minimum(start - reach, upper), upper, longest


def fit_modal_sum(
    problem: ModalProblem, start: ModalShape, rule: Rule
) -> tuple[ModalShape, Array]:
    """Return the best shape from a start, and its residues, (2, columns, outputs, inputs)."""
    x = problem.pack(start)
    lower, upper, longest = problem.bounds(x)
    best = minimise(lambda x: Point(problem, x), x, (lower, upper), rule=rule, longest=longest)
    return problem.unpack(best.x), best.point.residues


def residual_spectra(
    problem: ModalProblem, level: LevelSpectra, shape: ModalShape, residues: Array
) -> ComplexArray:
    """Return the residual of one level, delay removed, (lines, outputs, realisations)."""
    coordinate = problem.coordinate(level)
    response = shape.response(level.frequency_Hz, problem.lag_Hz, coordinate, residues)
    advance = np.exp(2j * np.pi * level.frequency_Hz * shape.delay_s)[:, None, None]
    return np.asarray(advance * level.displacement - response @ level.drive)


@dataclass(frozen=True, kw_only=True, eq=False)
class _WeightedLevel:
    """One level at one shape, weighted; the measurement is advanced by the delay.

    spread  (orders,)  what multiplies the residues: 1 and the coordinate of the level
    """

    frequency_Hz: Array
    columns: Columns
    drive: ComplexArray
    displacement: ComplexArray
    spread: Array

    def gram(self) -> Array:
        """Return A'A of one output, A the rows that its residues meet, (orders columns inputs,)^2.

        (A'A)_(ci, dk) = sum_f Re( conj(b_c) b_d sum_r conj(V_i) V_k ),   b columns, V the drive
        """
        b = self.columns.value
        count, inputs = b.shape[1], self.drive.shape[1]
        power = self.drive.conj() @ self.drive.transpose(0, 2, 1)
        gram = np.empty((count, inputs, count, inputs))
        for i in range(inputs):
            for k in range(inputs):
                gram[:, i, :, k] = ((b.conj() * power[:, i, k, None]).T @ b).real
        one_order = gram.reshape(count * inputs, count * inputs)
        return np.asarray(np.kron(np.outer(self.spread, self.spread), one_order), dtype=np.float64)

    def products(self, rows: ComplexArray) -> Array:
        """Return A' t for every output and vector t, (orders columns inputs, outputs, vectors).

        rows  (vectors, lines, outputs, realisations)  t
        """
        vectors, lines, outputs, _ = rows.shape
        count, inputs = self.columns.value.shape[1], self.drive.shape[1]
        by_input = np.matmul(rows, self.drive.conj().transpose(0, 2, 1))
        flat = by_input.transpose(1, 0, 2, 3).reshape(lines, -1)
        products = (self.columns.value.conj().T @ flat).real
        products = products.reshape(count, vectors, outputs, inputs).transpose(0, 3, 2, 1)
        products = products.reshape(count * inputs, outputs, vectors)
        return np.concatenate([share * products for share in self.spread])


class Point:
    """The best residues for a given shape, the residual and its projected linearisation."""

    def __init__(self, problem: ModalProblem, x: Array) -> None:
        self.problem, shape = problem, problem.unpack(x)
        self.levels = [_weighted(problem, level, shape) for level in problem.levels]
        gram, target = np.zeros(()), np.zeros(())
        for level in self.levels:
            gram = gram + level.gram()
            target = target + level.products(level.displacement[None])[..., 0]
        curvature = np.diag(gram)
        count = len(gram) // problem.orders
        penalty = np.concatenate([np.zeros(count), LEVEL_PENALTY * curvature[:count]])[: len(gram)]
        self.factor = cho_factor(gram + np.diag(penalty + RIDGE * curvature.max()))
        solution = cho_solve(self.factor, target)  # (orders columns inputs, outputs)
        inputs, outputs = self.levels[0].drive.shape[1], solution.shape[1]
        self.residues = np.zeros((2, count // inputs, outputs, inputs))
        by_order = solution.reshape(problem.orders, -1, inputs, outputs)
        self.residues[: problem.orders] = by_order.transpose(0, 1, 3, 2)
        self.residuals = [
            level.displacement
            - np.einsum("fc,coi->foi", level.columns.value, self._residues_at(level)) @ level.drive
            for level in self.levels
        ]
        self.cost = float(sum((np.abs(residual) ** 2).sum() for residual in self.residuals))
        self.cost += float((penalty[:, None] * solution**2).sum())

    def _residues_at(self, level: _WeightedLevel) -> Array:
        return np.asarray(np.tensordot(level.spread, self.residues[: self.problem.orders], 1))

    def linearised(self) -> NormalEquations:
        """Return the projected normal equations, in Kaufman's form."""
        gram, slope = np.zeros(()), np.zeros(())
        inner, penalised = np.zeros(()), np.zeros(())
        for level, residual in zip(self.levels, self.residuals, strict=True):
            tangents = self._tangents(level)
            flat = tangents.reshape(len(tangents), -1).view(np.float64)
            gram = gram + flat @ flat.T
            slope = slope - flat @ residual.reshape(-1).view(np.float64)
            products = level.products(np.concatenate([tangents, residual[None]]))
            inner = inner + products[..., :-1]
            penalised = penalised + products[..., -1]
        solution = cho_solve(self.factor, inner.reshape(len(inner), -1)).reshape(inner.shape)
        return NormalEquations(
            gram=np.asarray(gram - np.einsum("aon,aom->nm", inner, solution)),
            # with a penalty the residual is not exactly orthogonal to the columns
            slope=np.asarray(slope + np.einsum("aon,ao->n", solution, penalised)),
            cost=self.cost,
        )

    def _tangents(self, level: _WeightedLevel) -> ComplexArray:
        """Return the derivatives of the model, (parameters, lines, outputs, realisations)."""
        modes, real = self.problem.modes, self._residues_at(level)
        residues = real[:modes] + 1j * real[modes : 2 * modes]
        by_pole = np.stack(
            [
                0.5
                * (direct[:, m, None, None] * R + conjugate[:, m, None, None] * R.conj())
                @ level.drive
                for direct, conjugate in (level.columns.by_frequency, level.columns.by_damping)
                for m, R in enumerate(residues)
            ]
        )
        by_sample = -2j * np.pi * level.frequency_Hz[:, None, None] / self.problem.rate_Hz
        by_delay = (by_sample * level.displacement)[None]
        tangents = [*(share * by_pole for share in level.spread), by_delay]
        return np.ascontiguousarray(np.concatenate(tangents))


def _weighted(problem: ModalProblem, level: LevelSpectra, shape: ModalShape) -> _WeightedLevel:
    coordinate, root = problem.coordinate(level), np.sqrt(level.weight)
    advance = np.exp(2j * np.pi * level.frequency_Hz * shape.delay_s)[:, None, None]
    return _WeightedLevel(
        frequency_Hz=level.frequency_Hz,
        columns=shape.columns(level.frequency_Hz, problem.lag_Hz, coordinate),
        drive=level.drive * root,
        displacement=level.displacement * root * advance,
        spread=np.array([1.0, coordinate])[: problem.orders],
    )
