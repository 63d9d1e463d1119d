"""Poles, delay and terms by Gauss-Newton, the residues eliminated: variable projection.

    r_r = sqrt(w_r) (e^(j w delay) Y_r - G(s, l) (U_r + phi_r)),   G linear in its residues

Residues of all outputs meet the same rows, so one matrix of (columns x inputs) is factored for all
of them. In the form of Kaufman [Golub & Pereyra 1973]. What goes wrong: a
pole that no residue needs goes anywhere within its bounds.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from piezoid.identification.coupled.coupled_stage import level_coordinate
from piezoid.identification.coupled.hysteresis_terms import (
    oversampled,
)
from piezoid.identification.coupled.modal_sum import (
    complex_residues,
    gram_of_residues,
    modal_columns,
    products_with_residues,
)
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise

MOST_DAMPING = 0.3  # of a mode: beyond, a pole follows a slope
# Share of the curvature that holds a residue's change with the level: 1e-2 and 1e-3 leave the same
# on the steering mirror; without it, those of overlapping modes drift against each other.
HELD = 1e-3
LEAST = 1e-9  # of the curvature: columns that the band does not tell apart


@dataclass(frozen=True, kw_only=True, eq=False)
class Level:
    """One level: mean over periods.

    frequency_Hz  (lines,)
    drive         (lines, inputs, realisations), moved likewise; spectra of ``numpy.fft.rfft``
    terms         (TERMS, lines, inputs, realisations) or none
    weight        (realisations,)
    """

    level_V: float
    samples: int
    lines: np.ndarray
    frequency_Hz: Array
    drive: ComplexArray
    moved: ComplexArray
    weight: Array
    terms: ComplexArray | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Numbers:
    """The numbers that are searched for, unpacked."""

    log_frequency: Array
    log_damping: Array
    delay_s: float
    term_V: Array


@dataclass(frozen=True, kw_only=True, eq=False)
class Problem:
    """What is fitted to what: levels of data, and a model of so many modes."""

    levels: tuple[Level, ...]
    levels_V: Array
    rate_Hz: float
    lag_Hz: Array
    modes: int
    inputs: int

    def coordinate(self, level: Level) -> float:
        """Return where a level lies between the smallest, -1, and the largest, 1."""
        return level_coordinate(level.level_V, self.levels_V)

    @property
    def orders(self) -> int:
        """Return 1 where all data have one level, 2 where numbers may move with it."""
        return 1 if len(self.levels) == 1 else 2

    @property
    def has_terms(self) -> bool:
        """Return whether the drive passes hysteresis."""
        return self.levels[0].terms is not None

    def unpack(self, x: Array) -> Numbers:
        """Return what a vector of numbers stands for."""
        shapes = np.zeros((2, 2, self.modes))
        count = 2 * self.orders * self.modes
        shapes[: self.orders] = x[:count].reshape(self.orders, 2, self.modes)
        return Numbers(
            log_frequency=shapes[:, 0],
            log_damping=shapes[:, 1],
            delay_s=float(x[count]) / self.rate_Hz,
            term_V=x[count + 1 :].reshape(self.inputs, -1),
        )

    def pack(self, numbers: Numbers) -> Array:
        """Return the vector that stands for numbers."""
        shapes = np.stack([numbers.log_frequency, numbers.log_damping], axis=1)[: self.orders]
        terms = numbers.term_V.ravel() if self.has_terms else np.zeros(0)
        return np.concatenate([shapes.ravel(), [numbers.delay_s * self.rate_Hz], terms])

    def bounds(self, start: Array) -> tuple[Array, Array, Array]:
        """Return bounds and the longest step: a pole may not jump over its neighbour."""
        terms = len(start) - 2 * self.orders * self.modes - 1
        reach = np.repeat([0.2, 3.0, 0.05, 1.0], self.modes)[: 2 * self.orders * self.modes]
        reach = np.concatenate([reach, [10.0], np.full(terms, np.inf)])
        step = np.repeat([0.03, 0.4], self.modes)
        longest = np.concatenate([np.tile(step, self.orders), [0.3], np.full(terms, np.inf)])
        upper = start + reach
        upper[self.modes : 2 * self.modes] = np.log(MOST_DAMPING)
        return np.minimum(start - reach, upper), upper, longest


class Point:
    """The residues at their best for given numbers: what is left, and how it would move."""

    def __init__(self, problem: Problem, x: Array) -> None:
        self.problem, self.numbers = problem, problem.unpack(x)
        grams: list[Array] = []
        targets: list[Array] = []
        parts = []
        for level in problem.levels:
            part = self._part(level)
            parts.append(part)
            spread = np.array([1.0, problem.coordinate(level)])[: problem.orders]
            own = gram_of_residues(part.columns, part.driven)
            met = products_with_residues(part.columns, part.driven, part.moved[None])[..., 0]
            grams.append(np.asarray(np.kron(np.outer(spread, spread), own), dtype=np.float64))
            targets.append(np.concatenate([scale * met for scale in spread]))
        gram, target = np.sum(grams, axis=0), np.sum(targets, axis=0)
        count = len(gram) // problem.orders
        held = np.concatenate([np.zeros(count), HELD * np.diag(gram)[:count]])[: len(gram)]
        stiff = gram + np.diag(held + LEAST * np.diag(gram).max())
        self.factor = cho_factor(stiff)
        solved = cho_solve(self.factor, target)  # (orders columns inputs, outputs)
        shape = (problem.orders, -1, problem.inputs, solved.shape[1])
        self.residue = np.zeros((2, count // problem.inputs, solved.shape[1], problem.inputs))
        self.residue[: problem.orders] = solved.reshape(shape).transpose(0, 1, 3, 2)
        self.parts = [self._left(level, p) for level, p in zip(problem.levels, parts, strict=True)]
        self.cost = float(sum((np.abs(p.left) ** 2).sum() for p in self.parts))
        self.cost += float((held[:, None] * solved**2).sum())

    def _part(self, level: Level) -> "_Part":
        l, n = self.problem.coordinate(level), self.numbers  # noqa: E741
        full = modal_columns(
            level.frequency_Hz,
            n.log_frequency[0] + l * n.log_frequency[1],
            n.log_damping[0] + l * n.log_damping[1],
            self.problem.lag_Hz,
        )
        driven = level.drive
        if level.terms is not None:
            driven = driven + np.einsum("ik,kfir->fir", n.term_V, level.terms)
        root = np.sqrt(level.weight)
        advanced = np.exp(2j * np.pi * level.frequency_Hz * n.delay_s)[:, None, None]
        return _Part(
            columns=full.value,
            by_shape=np.stack([full.by_frequency, full.by_damping]),
            driven=driven * root,
            moved=level.moved * root * advanced,
            left=level.moved,
            response=level.moved,
        )

    def _left(self, level: Level, part: "_Part") -> "_Part":
        residue = self.residue[0] + self.problem.coordinate(level) * self.residue[1]
        response = np.einsum("fc,coi->foi", part.columns, residue)
        return replace(part, response=response, left=part.moved - response @ part.driven)

    def linearised(self) -> NormalEquations:
        """Return the projected normal equations, in Kaufman's form."""
        grams, slopes, inner, left = [], [], [], []
        for level, part in zip(self.problem.levels, self.parts, strict=True):
            tangents = self._tangents(level, part)
            flat = tangents.reshape(len(tangents), -1).view(np.float64)
            grams.append(flat @ flat.T)
            slopes.append(-flat @ part.left.reshape(-1).view(np.float64))
            rows = np.concatenate([tangents, part.left[None]])
            met = products_with_residues(part.columns, part.driven, rows)
            spread = np.array([1.0, self.problem.coordinate(level)])[: self.problem.orders]
            both = np.concatenate([scale * met for scale in spread])
            inner.append(both[..., :-1])
            left.append(both[..., -1])
        inside = np.sum(inner, axis=0)
        solved = cho_solve(self.factor, inside.reshape(len(inside), -1)).reshape(inside.shape)
        # what is left is not quite free of the columns, for the residues are held a little
        held = np.einsum("aon,ao->n", solved, np.sum(left, axis=0))
        return NormalEquations(
            gram=np.sum(grams, axis=0) - np.einsum("aon,aom->nm", inside, solved),
            slope=np.sum(slopes, axis=0) + held,
            cost=self.cost,
        )

    def _tangents(self, level: Level, part: "_Part") -> ComplexArray:
        """Return how the model moves with each number, (numbers, lines, outputs, realisations)."""
        problem, l = self.problem, self.problem.coordinate(level)  # noqa: E741
        residue = complex_residues(self.residue[0] + l * self.residue[1], problem.modes)
        shapes = []
        for direct, mirrored in part.by_shape:  # (lines, modes) each
            for m, R in enumerate(residue):
                turned = direct[:, m, None, None] * R + mirrored[:, m, None, None] * R.conj()
                shapes.append(0.5 * turned @ part.driven)
        stacked = np.stack(shapes)
        found = [stacked, l * stacked][: problem.orders]
        w = 2j * np.pi * level.frequency_Hz[:, None, None] / problem.rate_Hz
        found.append((-w * part.moved)[None])
        if level.terms is not None:
            root = np.sqrt(level.weight)
            for i in range(problem.inputs):
                own = part.response[None, :, :, i, None] * level.terms[:, :, i, None, :]
                found.append(own * root)
        return np.ascontiguousarray(np.concatenate(found))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Part:
    """One level at a point: what meets the residues, weighted; the delay is on the other side."""

    columns: ComplexArray
    by_shape: ComplexArray
    driven: ComplexArray
    moved: ComplexArray
    left: ComplexArray
    response: ComplexArray


def fitted(problem: Problem, numbers: Numbers, rule: Rule) -> tuple[Numbers, Array]:
    """Return the best numbers from a start, and the residues there."""
    start = problem.pack(numbers)
    lower, upper, longest = problem.bounds(start)
    found = minimise(
        lambda x: Point(problem, x), start, (lower, upper), rule=rule, longest=longest
    )
    unpacked = problem.unpack(found.x)
    if not problem.has_terms:
        unpacked = replace(unpacked, term_V=numbers.term_V)
    return unpacked, found.point.residue


def elongations_of(
    problem: Problem, level: Level, numbers: Numbers, residue: Array, elongation: Array
) -> tuple[Array, Array]:
    """Return drives and elongations, (fine samples, inputs, realisations), V."""
    l = problem.coordinate(level)  # noqa: E741
    columns = columns_at(problem, level, numbers)
    linear = np.einsum("fc,coi->foi", columns, residue[0] + l * residue[1])
    drive = np.zeros((level.samples // 2 + 1, *level.drive.shape[1:]), dtype=np.complex128)
    moved = drive.copy()
    drive[level.lines] = level.drive
    moved[level.lines] = elongation @ (linear @ level.drive)
    return oversampled(drive, level.samples), oversampled(moved, level.samples)


def columns_at(problem: Problem, level: Level, numbers: Numbers) -> ComplexArray:
    """Return what residues multiply at one level, (lines, columns)."""
    l = problem.coordinate(level)  # noqa: E741
    return modal_columns(
        level.frequency_Hz,
        numbers.log_frequency[0] + l * numbers.log_frequency[1],
        numbers.log_damping[0] + l * numbers.log_damping[1],
        problem.lag_Hz,
    ).value


def left_by(problem: Problem, place: int, numbers: Numbers, residue: Array) -> ComplexArray:
    """Return what a model leaves of one level, undelayed, (lines, outputs, realisations)."""
    level = problem.levels[place]
    columns = columns_at(problem, level, numbers)
    l = problem.coordinate(level)  # noqa: E741
    response = np.einsum("fc,coi->foi", columns, residue[0] + l * residue[1])
    driven = level.drive
    if level.terms is not None:
        driven = driven + np.einsum("ik,kfir->fir", numbers.term_V, level.terms)
    advanced = np.exp(2j * np.pi * level.frequency_Hz * numbers.delay_s)[:, None, None]
    return np.asarray(advanced * level.moved - response @ driven)


def without_realisation(problem: Problem, realisation: int) -> Problem:
    """Return the problem with one realisation left out."""
    levels = []
    for level in problem.levels:
        kept = np.arange(level.drive.shape[2]) != realisation
        levels.append(
            replace(
                level,
                drive=level.drive[:, :, kept],
                moved=level.moved[:, :, kept],
                weight=level.weight[kept],
                terms=None if level.terms is None else level.terms[..., kept],
            )
        )
    return replace(problem, levels=tuple(levels))
