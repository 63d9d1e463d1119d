"""Fit a CoupledStage to periodic data of a stage with several drives, at several levels.

    min sum_r w_r |Y_r - e^(-s delay) G(s, l) U_r|^2

over all excited lines. Residues are linear and eliminated [Golub & Pereyra 1973]; poles and delay
are searched for. Vector fitting gives a start for the largest level, whose fit is the start for
the smallest level; both give a linear change with the level. The weight w_r of a realisation is
one over the residual power of a first fit, so that disturbed realisations count less.

The residues of all outputs have the same columns, so one matrix of (columns x inputs) is factored
for all of them. The Jacobian is in the form of Kaufman. A pole with negligible residues can move
anywhere within its bounds.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.ndimage import uniform_filter1d

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.coupled.coupled_stage import CoupledStage, ModalShape, level_coordinate
from piezoid.identification.dynamics.frequency_response import PeriodicData
from piezoid.identification.dynamics.vector_fitting import start_poles, vector_fit
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.executor import on_one_thread
from piezoid.numerics.levenberg_marquardt import NormalEquations, Rule, minimise

MAX_DAMPING = 0.3  # of a mode: a pole with more damping follows a slope
# Penalty on the change of a residue with the level, relative to the curvature: 1e-2 and 1e-3 give
# the same residual on the steering mirror; without it residues of overlapping modes diverge.
LEVEL_PENALTY = 1e-3
RIDGE = 1e-9  # of the curvature, for columns that are nearly equal within the band
LAGS_PER_DECADE = 1.3  # real poles below the first mode, for creep
SMOOTHED_LINES = 5  # of the response for the start: otherwise poles follow the noise of lines
START_DAMPING = (0.003, 0.3)  # below, a pole follows noise; above, a slope
MIN_DISTANCE = 0.02  # relative, of two modes: levels of 1 to 3 move a mode by up to half of it
FINAL_RULE = Rule(tolerance=2e-3, iterations=12)
JACKKNIFE_RULE = Rule(tolerance=2e-3, iterations=3)


@dataclass(frozen=True, kw_only=True, eq=False)
class LevelSpectra:
    """Spectra at the excited lines of one level, means over the periods.

    level_V       rms of the drive
    frequency_Hz  (lines,)
    drive         (lines, inputs, realisations)   peak amplitudes, V
    displacement  (lines, outputs, realisations)  peak amplitudes, m
    weight        (realisations,)
    """

    level_V: float
    frequency_Hz: Array
    drive: ComplexArray
    displacement: ComplexArray
    weight: Array

    @staticmethod
    def of(data: PeriodicData) -> "LevelSpectra":
        """Return the spectra of periodic data, realisations weighted by one over their power."""
        lines = data.excited_lines()
        drive, displacement = (spectra.mean(axis=3) for spectra in data.spectra(lines))
        return LevelSpectra(
            level_V=float(data.voltage_V.std()),
            frequency_Hz=data.frequency_Hz(lines),
            drive=drive,
            displacement=displacement,
            weight=1.0 / (np.abs(displacement) ** 2).sum(axis=(0, 1)),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class ModalProblem:
    """Spectra of all levels and the structure of the fit.

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
        """1 if all data have one level, 2 if parameters change with the level."""
        return 1 if len(self.levels) == 1 else 2

    def unpack(self, x: Array) -> ModalShape:
        """Return the shape of a parameter vector."""
        poles = np.zeros((2, 2, self.modes))
        poles[: self.orders] = x[:-1].reshape(self.orders, 2, self.modes)
        return ModalShape(
            log_frequency=poles[:, 0],
            log_damping=poles[:, 1],
            delay_s=float(x[-1]) / self.rate_Hz,
        )


def fit_modal_sum(problem: ModalProblem, start: ModalShape, rule: Rule) -> "Point":
    """Minimise the cost from a start."""
    modes, orders = problem.modes, problem.orders
    poles = np.stack([start.log_frequency, start.log_damping], axis=1)[:orders]
    x = np.append(poles.ravel(), start.delay_s * problem.rate_Hz)
    # No pole passes its neighbour.
    reach = np.append(np.repeat([0.2, 3.0, 0.05, 1.0], modes)[: len(x) - 1], 10.0)
    longest = np.append(np.tile(np.repeat([0.03, 0.4], modes), orders), 0.3)
    upper = x + reach
    upper[modes : 2 * modes] = np.log(MAX_DAMPING)
    lower = np.minimum(x - reach, upper)
    search = minimise(lambda x: Point(problem, x), x, (lower, upper), rule=rule, longest=longest)
    return search.point


@dataclass(frozen=True, kw_only=True, eq=False)
class _WeightedLevel:
    """Weighted data and columns of one level at one shape, the delay removed from the data.

    columns, by_frequency, by_damping  as ``ModalShape.columns``
    powers  (orders,)  factors of the residues: 1 and the coordinate of the level
    """

    frequency_Hz: Array
    columns: ComplexArray
    by_frequency: ComplexArray
    by_damping: ComplexArray
    drive: ComplexArray
    displacement: ComplexArray
    powers: Array

    def gram(self) -> Array:
        """Return A'A for the design matrix A of one output, (orders columns inputs,)^2.

        (A'A)_(ci, dk) = sum_f Re( conj(b_c) b_d sum_r conj(V_i) V_k ),   b columns, V the drive
        """
        b = self.columns
        count, inputs = b.shape[1], self.drive.shape[1]
        power = self.drive.conj() @ self.drive.transpose(0, 2, 1)
        gram = np.empty((count, inputs, count, inputs))
        for i in range(inputs):
            for k in range(inputs):
                gram[:, i, :, k] = ((b.conj() * power[:, i, k, None]).T @ b).real
        one_order = gram.reshape(count * inputs, count * inputs)
        return np.asarray(np.kron(np.outer(self.powers, self.powers), one_order), dtype=np.float64)

    def products(self, rows: ComplexArray) -> Array:
        """Return A' t for every output and vector t, (orders columns inputs, outputs, vectors).

        rows  (vectors, lines, outputs, realisations)  t
        """
        vectors, lines, outputs, _ = rows.shape
        count, inputs = self.columns.shape[1], self.drive.shape[1]
        by_input = np.matmul(rows, self.drive.conj().transpose(0, 2, 1))
        flat = by_input.transpose(1, 0, 2, 3).reshape(lines, -1)
        products = (self.columns.conj().T @ flat).real
        products = products.reshape(count, vectors, outputs, inputs).transpose(0, 3, 2, 1)
        products = products.reshape(count * inputs, outputs, vectors)
        return np.concatenate([power * products for power in self.powers])


class Point:
    """Optimal residues for a given shape, the residual and its projected linearisation.

    shape      poles and delay
    residues   (2, columns, outputs, inputs)  at the centre of the levels, and the change
    residuals  (lines, outputs, realisations)  weighted, for each level
    """

    def __init__(self, problem: ModalProblem, x: Array) -> None:
        self.problem, self.shape = problem, (shape := problem.unpack(x))
        self.levels = []
        for level in problem.levels:
            f, coordinate = level.frequency_Hz, level_coordinate(level.level_V, problem.levels_V)
            root = np.sqrt(level.weight)
            advance = np.exp(2j * np.pi * f * shape.delay_s)[:, None, None]
            columns, by_frequency, by_damping = shape.columns(f, problem.lag_Hz, coordinate)
            weighted = _WeightedLevel(
                frequency_Hz=f,
                columns=columns,
                by_frequency=by_frequency,
                by_damping=by_damping,
                drive=level.drive * root,
                displacement=level.displacement * root * advance,
                powers=np.array([1.0, coordinate])[: problem.orders],
            )
            self.levels.append(weighted)
        gram, target = np.zeros(()), np.zeros(())
        for weighted in self.levels:
            gram = gram + weighted.gram()
            target = target + weighted.products(weighted.displacement[None])[..., 0]
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
            - np.einsum("fc,coi->foi", level.columns, self._residues_at(level)) @ level.drive
            for level in self.levels
        ]
        self.cost = float(sum((np.abs(residual) ** 2).sum() for residual in self.residuals))
        self.cost += float((penalty[:, None] * solution**2).sum())

    def _residues_at(self, level: _WeightedLevel) -> Array:
        return np.asarray(np.tensordot(level.powers, self.residues[: self.problem.orders], 1))

    def linearised(self) -> NormalEquations:
        """Return the projected normal equations, in Kaufman's form."""
        modes, gram, slope = self.problem.modes, np.zeros(()), np.zeros(())
        inner, penalised = np.zeros(()), np.zeros(())
        for level, residual in zip(self.levels, self.residuals, strict=True):
            # Derivatives of the model, (parameters, lines, outputs, realisations).
            real = self._residues_at(level)
            residues = real[:modes] + 1j * real[modes : 2 * modes]
            by_pole = np.stack(
                [
                    0.5
                    * (direct[:, m, None, None] * R + conjugate[:, m, None, None] * R.conj())
                    @ level.drive
                    for direct, conjugate in (level.by_frequency, level.by_damping)
                    for m, R in enumerate(residues)
                ]
            )
            by_sample = -2j * np.pi * level.frequency_Hz[:, None, None] / self.problem.rate_Hz
            by_delay = (by_sample * level.displacement)[None]
            tangents = np.ascontiguousarray(
                np.concatenate([*(power * by_pole for power in level.powers), by_delay])
            )
            flat = tangents.reshape(len(tangents), -1).view(np.float64)
            gram = gram + flat @ flat.T
            slope = slope - flat @ residual.reshape(-1).view(np.float64)
            products = level.products(np.concatenate([tangents, residual[None]]))
            inner = inner + products[..., :-1]
            penalised = penalised + products[..., -1]
        solution = cho_solve(self.factor, inner.reshape(len(inner), -1)).reshape(inner.shape)
        return NormalEquations(
            gram=np.asarray(gram - np.einsum("aon,aom->nm", inner, solution)),
            # With a penalty the residual is not exactly orthogonal to the columns.
            slope=np.asarray(slope + np.einsum("aon,ao->n", solution, penalised)),
            cost=self.cost,
        )


@on_one_thread
def fit_coupled(
    levels: Sequence[PeriodicData], *, modes: int = 20, intervals: bool = True
) -> CoupledStage:
    """Fit one linear model to the steady state of a stage at one or several levels of the drive.

    levels     periodic data with the same lines, inputs and outputs, one record for each level;
               more realisations than inputs in each
    modes      maximum number of pairs of poles of the start; poles that follow noise are removed
    intervals  whether to refit without each realisation, for the jackknife; triples the time

    Y = e^(-s delay) G(s, level) U, as in ``CoupledStage``. Distortion counts as noise that is
    independent in each realisation [Pintelon & Schoukens 2012].

    Raises ``ExcitationError`` for records that differ in more than their level, or for too few
    realisations; ``IdentificationError`` if no start has a mode in the band.

    >>> coupled = piezoid.fit_coupled(levels, modes=2, intervals=False)
    >>> coupled.inputs, coupled.outputs
    (('x',), ('x',))
    """
    data = sorted(levels, key=lambda level: float(level.voltage_V.std()))
    _check_levels(data)
    fit = _fit_all_levels(data, modes)
    problem, shape = fit.problem, fit.shape
    count = min(level.voltage_V.shape[2] for level in data)
    is_left_out = intervals and count > len(data[0].inputs) + 1
    fits = [fit] * count
    if is_left_out:
        for r in range(count):
            remaining = tuple(
                replace(
                    level,
                    drive=np.delete(level.drive, r, axis=2),
                    displacement=np.delete(level.displacement, r, axis=2),
                    weight=np.delete(level.weight, r),
                )
                for level in problem.levels
            )
            fits[r] = fit_modal_sum(replace(problem, levels=remaining), shape, JACKKNIFE_RULE)
    errors_m = []
    for level in problem.levels:
        power = [
            (np.abs(_residual(problem, level, partial)[..., r]) ** 2).sum(axis=0)
            for r, partial in enumerate(fits)
        ]
        errors_m.append(np.sqrt(0.5 * np.mean(power, axis=0)))
    noise_m = []
    for level_data in data:
        moved_m, periods = level_data.displacement_m, level_data.displacement_m.shape[3]
        deviation_m = _rms(moved_m - moved_m.mean(axis=3, keepdims=True))
        noise_m.append(deviation_m * float(np.sqrt(periods / max(periods - 1, 1))))
    f = problem.levels[0].frequency_Hz
    return CoupledStage(
        inputs=data[0].inputs,
        outputs=data[0].outputs,
        sampling_rate_Hz=problem.rate_Hz,
        band_Hz=(float(f[0]), float(f[-1])),
        levels_V=problem.levels_V,
        log_frequency=shape.log_frequency,
        log_damping=shape.log_damping,
        lag_Hz=problem.lag_Hz,
        residue_m_per_V=fit.residues,
        delay_s=shape.delay_s,
        replicate_frequency=np.stack(
            [partial.shape.log_frequency for partial in (fits if is_left_out else fits[:1])]
        ),
        moved_rms_m=np.stack(
            [_rms(level.displacement_m - level.displacement_m.mean(axis=0)) for level in data]
        ),
        noise_rms_m=np.stack(noise_m),
        error_rms_m=np.stack(errors_m),
        error_is_left_out=is_left_out,
    )


def _residual(problem: ModalProblem, level: LevelSpectra, fit: Point) -> ComplexArray:
    """Return the residual of one level, delay removed, (lines, outputs, realisations)."""
    f, coordinate = level.frequency_Hz, level_coordinate(level.level_V, problem.levels_V)
    response = fit.shape.response(f, problem.lag_Hz, coordinate, fit.residues)
    advance = np.exp(2j * np.pi * f * fit.shape.delay_s)[:, None, None]
    return np.asarray(advance * level.displacement - response @ level.drive)


def _check_levels(data: Sequence[PeriodicData]) -> None:
    if not data:
        raise ExcitationError("no record", needed="at least one", remedy="Give one per level.")
    for first, level in pairwise([data[0], *data]):
        described = [
            (d.inputs, d.outputs, d.sampling_rate_Hz, len(d.voltage_V)) for d in (first, level)
        ]
        if described[0] != described[1]:
            raise ExcitationError(
                f"records of {first.inputs} and {level.inputs} at {first.sampling_rate_Hz:g} and "
                f"{level.sampling_rate_Hz:g} Hz, periods of {len(first.voltage_V)} and "
                f"{len(level.voltage_V)} samples",
                needed="the same drives, sensors, rate and period at all levels",
                remedy="Fit them separately, or record all levels alike.",
            )
        if level.voltage_V.shape[2] <= len(level.inputs):
            raise ExcitationError(
                f"{level.voltage_V.shape[2]} realisations for {len(level.inputs)} drives",
                needed=f"at least {len(level.inputs) + 1}, to estimate the distortion",
                remedy="Record more realisations of the multisine.",
            )


def _fit_all_levels(data: Sequence[PeriodicData], modes: int) -> Point:
    """Fit the largest level, then the smallest from its result, then all levels, reweighted."""
    levels = tuple(LevelSpectra.of(level) for level in data)
    # A weak mode near a strong mode may be visible at one level only.
    poles = _start_of_level(levels[-1], modes)
    for level in levels[-2::-1]:
        new_modes = _start_of_level(level, modes)
        distance = np.abs(new_modes[0][:, None] - poles[0]).min(axis=1)
        poles = np.concatenate([poles, new_modes[:, distance > MIN_DISTANCE]], axis=1)
    poles = poles[:, np.argsort(poles[0])]
    count, low_Hz = poles.shape[1], float(levels[-1].frequency_Hz[0])
    first_Hz = float(np.exp(poles[0].min()))
    lags = max(1, round(LAGS_PER_DECADE * np.log10(max(first_Hz / low_Hz, 1.01))))
    problem = ModalProblem(
        levels=levels,
        rate_Hz=data[0].sampling_rate_Hz,
        lag_Hz=np.geomspace(low_Hz, 0.25 * first_Hz, lags + 1),
        modes=count,
    )
    no_change = np.zeros(count)
    shape = ModalShape(
        log_frequency=np.stack([poles[0], no_change]),
        log_damping=np.stack([poles[1], no_change]),
        delay_s=0.0,
    )
    fit = fit_modal_sum(replace(problem, levels=levels[-1:]), shape, FINAL_RULE)
    if len(levels) == 1:
        return fit
    largest = fit.shape
    smallest = fit_modal_sum(replace(problem, levels=levels[:1]), largest, FINAL_RULE).shape
    shape = replace(
        largest,
        log_frequency=_line(smallest.log_frequency[0], largest.log_frequency[0]),
        log_damping=_line(smallest.log_damping[0], largest.log_damping[0]),
    )
    fit = fit_modal_sum(problem, shape, FINAL_RULE)
    # The weight of a realisation is one over the power of its residual.
    reweighted = tuple(
        replace(level, weight=level.weight / (np.abs(residual) ** 2).sum(axis=(0, 1)))
        for level, residual in zip(levels, fit.residuals, strict=True)
    )
    return fit_modal_sum(replace(problem, levels=reweighted), fit.shape, FINAL_RULE)


def _line(low: Array, high: Array) -> Array:
    """Return mean and half difference; unmatched modes, 0.5 or more apart, keep ``high``."""
    difference = np.where(np.abs(high - low) < 0.5, high - low, 0.0)
    return np.stack([high - difference / 2, difference / 2])


def _start_of_level(level: LevelSpectra, modes: int) -> Array:
    """Return log frequencies and log dampings of the modes of a smoothed response, (2, modes)."""
    U, Y = level.drive, level.displacement
    gram, cross = (
        uniform_filter1d(spectra @ U.conj().transpose(0, 2, 1), SMOOTHED_LINES, 0, mode="constant")
        for spectra in (U, Y)
    )
    G = cross @ np.linalg.inv(gram)
    half = SMOOTHED_LINES // 2
    inner = slice(half, len(G) - half, half)
    f, G = level.frequency_Hz[inner], G[inner].reshape(len(level.frequency_Hz[inner]), -1)
    unit_Hz = float(f[-1]) / np.pi
    s = np.asarray(1j * f / unit_Hz, dtype=np.complex128)
    G = np.asarray(G / np.sqrt((np.abs(G) ** 2).mean()), dtype=np.complex128)
    start = start_poles(0.1 * np.pi, 1.02 * np.pi, modes, 1)
    poles = vector_fit(s, G, np.ones(G.shape), start, rounds=40)
    pairs = poles[poles.imag > 0]
    frequency_Hz, damping = np.abs(pairs) * unit_Hz, -pairs.real / np.abs(pairs)
    is_mode = (damping > START_DAMPING[0]) & (damping < START_DAMPING[1])
    is_mode &= frequency_Hz > 10.0 * f[0]
    if not is_mode.any():
        raise IdentificationError(
            f"no resonance between {f[0]:.4g} and {f[-1]:.4g} Hz",
            needed="at least one",
            remedy="Fit each axis separately with piezoid.fit.",
        )
    return np.asarray(np.log(np.stack([frequency_Hz[is_mode], damping[is_mode]])))


def _rms(moved_m: Array) -> Array:
    """Return the rms of each output, (outputs,), of (samples, outputs, ...)."""
    return np.asarray(np.sqrt((moved_m**2).mean(axis=(0, *range(2, moved_m.ndim)))))
