"""fit_coupled: periodic records of a stage with several drives, at several levels -> CoupledStage.

    min sum_r w_r |Y_r - e^(-s delay) G(s, l) (U_r + phi_r)|^2

over all excited lines. Residues are linear and eliminated [Golub & Pereyra 1973]; poles, delay and
the coefficients of hysteresis are searched for. Starts: vector fitting for the largest level, its
poles for the smallest, a straight line between them. The weight w_r of a record is one over what
the linear fit left of it: what is disturbed counts less.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.identification.coupled.distortion import (
    distortion_terms,
    fitted_distortion,
    is_determined,
)
from piezoid.identification.coupled.hysteresis_terms import (
    TERMS,
    at_lines,
    hysteresis_terms,
    linear_share,
)
from piezoid.identification.coupled.modal_sum import modal_columns
from piezoid.identification.coupled.projected_fit import (
    MOST_DAMPING,
    Level,
    Numbers,
    Point,
    Problem,
    columns_at,
    elongations_of,
    fitted,
    left_by,
    without_realisation,
)
from piezoid.identification.dynamics.periodic_estimate import PeriodicData
from piezoid.identification.dynamics.vector_fitting import start_poles, vector_fit
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.executor import on_one_thread
from piezoid.numerics.levenberg_marquardt import Rule

LAGS_PER_DECADE = 1.3  # real poles below the first mode: a ladder for creep
SMOOTHED = 5  # lines the start is averaged over: single ones give poles of noise
LEAST_DAMPING = 0.003  # of a start: below, a pole follows noise
ANOTHER = 0.02  # relative distance of modes: levels of 1 to 3 move one by up to half as much
ROUNDS = 2  # of terms from elongations, elongations from the fit
GROUPS = 3  # of realisations, for the error of the distortion where it is left out
WORTH = 0.98  # of what is left without: distortion must take so much off realisations left out
LINEAR, WITH_TERMS, LEFT_OUT = (
    Rule(tolerance=2e-3, iterations=12),
    Rule(tolerance=2e-3, iterations=6),
    Rule(tolerance=2e-3, iterations=3),
)


@on_one_thread
def fit_coupled(
    levels: Sequence[PeriodicData], *, modes: int = 20, intervals: bool = True
) -> CoupledStage:
    """Fit one model to the steady answers of a stage at one or several levels of the drive.

    levels     periodic records with the same lines, inputs and outputs, one for each level; more
               realisations than inputs in each
    modes      pairs of poles that the start may have; those that follow noise are left out of it
    intervals  fit again without each realisation, for the jackknife; about twice as long again

    Y = e^(-s delay) G(s, level) (U + phi), as of ``CoupledStage``; residues by least squares, the
    rest by Gauss-Newton with the residues eliminated [Golub & Pereyra 1973]. Distortion counts as
    noise that comes anew with each realisation [Pintelon & Schoukens 2012].

    Raises ``ExcitationError`` for records that differ in more than their level, or for too few
    realisations; ``IdentificationError`` where no start has a mode in the band.

    >>> coupled = piezoid.fit_coupled(levels, modes=2, intervals=False)
    >>> coupled.inputs, coupled.outputs
    (('x',), ('x',))
    """
    data = sorted(levels, key=lambda one: float(one.voltage_V.std()))
    _check(data)
    problem, numbers, residue = _linear_fit(data, modes)
    elongation: Array = np.asarray(
        np.linalg.pinv(_low_response(problem, numbers, residue)), dtype=np.float64
    )
    scale = _scales(problem, numbers, residue, elongation)
    for _ in range(ROUNDS):
        problem, share = _with_terms(problem, numbers, residue, elongation, scale)
        numbers, residue = fitted(problem, numbers, WITH_TERMS)
    shapes = [numbers]
    count = min(one.voltage_V.shape[2] for one in data)
    models = [(numbers, residue)] * count
    is_left_out = intervals and count > problem.inputs + 1
    if is_left_out:
        models = [fitted(without_realisation(problem, r), numbers, LEFT_OUT) for r in range(count)]
        shapes = [one for one, _ in models]
    linear = [left_by(problem, k, numbers, residue) for k in range(len(data))]
    groups = np.array_split(np.arange(count), GROUPS if is_left_out else 2)
    whole, apart = _distortion(problem, numbers, linear, elongation, scale, groups)
    error = []
    for k, level in enumerate(problem.levels):
        own = np.empty((count, len(data[0].outputs)))
        for group, added in zip(groups, apart, strict=True):
            for r in group:
                rest = left_by(problem, k, *models[r])[..., r]
                rest = rest - (0.0 if added is None else added.lines(k)[..., r])
                own[r] = np.sqrt(2.0 * (np.abs(rest) ** 2).sum(axis=0)) / level.samples
        error.append(own)
    return CoupledStage(
        inputs=data[0].inputs,
        outputs=data[0].outputs,
        sampling_rate_Hz=problem.rate_Hz,
        band_Hz=(
            float(problem.levels[0].frequency_Hz[0]),
            float(problem.levels[0].frequency_Hz[-1]),
        ),
        levels_V=problem.levels_V,
        log_frequency=numbers.log_frequency,
        log_damping=numbers.log_damping,
        lag_Hz=problem.lag_Hz,
        residue_m_per_V=residue,
        delay_s=numbers.delay_s,
        elongation_V_per_m=elongation,
        scale_V=scale,
        term_V=numbers.term_V,
        linear_V=np.einsum("ick,ik->ci", share, numbers.term_V),
        replicate_frequency=np.stack([one.log_frequency for one in shapes]),
        equivalent_gain=_equivalent_gains(problem, numbers, residue, elongation),
        moved_rms_m=np.stack(
            [_rms(one.displacement_m - one.displacement_m.mean(axis=0)) for one in data]
        ),
        noise_rms_m=np.stack([_noise(one) for one in data]),
        error_rms_m=np.stack([np.sqrt((one**2).mean(axis=0)) for one in error]),
        error_is_left_out=is_left_out,
        distortion_m=None if whole is None else whole.weight,
    )


def _check(data: Sequence[PeriodicData]) -> None:
    if not data:
        raise ExcitationError("no record", needed="at least one", remedy="Give one per level.")
    first = data[0]
    for one in data:
        same = (one.inputs, one.outputs, one.sampling_rate_Hz, one.voltage_V.shape[0])
        if same != (first.inputs, first.outputs, first.sampling_rate_Hz, len(first.voltage_V)):
            raise ExcitationError(
                f"records of {first.inputs} and {one.inputs} at {first.sampling_rate_Hz:g} and "
                f"{one.sampling_rate_Hz:g} Hz, periods of {len(first.voltage_V)} and "
                f"{one.voltage_V.shape[0]} samples",
                needed="the same drives, sensors, rate and period at all levels",
                remedy="Fit them apart, or record all levels alike.",
            )
        if one.voltage_V.shape[2] <= len(one.inputs):
            raise ExcitationError(
                f"{one.voltage_V.shape[2]} realisations for {len(one.inputs)} drives",
                needed=f"at least {len(one.inputs) + 1}: distortion is what they differ in",
                remedy="Record more realisations of the multisine.",
            )


def _level(data: PeriodicData) -> Level:
    lines = data.excited_lines()
    drive = np.fft.rfft(data.voltage_V.mean(axis=3), axis=0)[lines]
    moved = np.fft.rfft(data.displacement_m.mean(axis=3), axis=0)[lines]
    power = (np.abs(moved) ** 2).sum(axis=(0, 1))
    return Level(
        level_V=float(data.voltage_V.std()),
        samples=len(data.voltage_V),
        lines=lines,
        frequency_Hz=data.frequency_Hz(lines),
        drive=drive,
        moved=moved,
        weight=1.0 / power,
    )


def _linear_fit(data: Sequence[PeriodicData], modes: int) -> tuple[Problem, Numbers, Array]:
    levels = tuple(_level(one) for one in data)
    shapes = _starts(levels, modes)
    count, low = shapes.shape[1], float(levels[-1].frequency_Hz[0])
    first = float(np.exp(shapes[0].min()))
    ladder = max(1, round(LAGS_PER_DECADE * np.log10(max(first / low, 1.01))))
    whole = Problem(
        levels=levels,
        levels_V=np.array([level.level_V for level in levels]),
        rate_Hz=data[0].sampling_rate_Hz,
        lag_Hz=np.geomspace(low, 0.25 * first, ladder + 1)[: ladder + 1],
        modes=count,
        inputs=len(data[0].inputs),
    )
    nothing = np.zeros((whole.inputs, TERMS))
    numbers = Numbers(
        log_frequency=np.stack([shapes[0], np.zeros(count)]),
        log_damping=np.stack([shapes[1], np.zeros(count)]),
        delay_s=0.0,
        term_V=nothing,
    )
    ends = []
    for level in levels[:: 1 - len(levels)] if len(levels) > 1 else levels:
        alone = replace(whole, levels=(level,), levels_V=np.array([level.level_V]))
        numbers, residue = fitted(alone, numbers, LINEAR)
        ends.append(numbers)
    if len(ends) == 1:
        return whole, numbers, residue
    high, small = ends
    numbers = replace(
        high,
        log_frequency=_line(small.log_frequency[0], high.log_frequency[0]),
        log_damping=_line(small.log_damping[0], high.log_damping[0]),
    )
    numbers, residue = fitted(whole, numbers, LINEAR)
    point = Point(whole, whole.pack(numbers))
    weighted = tuple(
        replace(level, weight=level.weight / (np.abs(part.left) ** 2).sum(axis=(0, 1)))
        for level, part in zip(whole.levels, point.parts, strict=True)
    )
    return replace(whole, levels=weighted), numbers, residue


def _line(low: Array, high: Array) -> Array:
    """Return middle and half difference; a mode whose partner moved away stays where it was."""
    apart = np.where(np.abs(high - low) < 0.5, high - low, 0.0)
    return np.stack([high - apart / 2, apart / 2])


def _starts(levels: Sequence[Level], modes: int) -> Array:
    """Return those of the largest level, and what other levels show and it does not.

    A weak mode beside a strong one is found at one level and missed at another.
    """
    found = _start(levels[-1], modes)
    for level in levels[-2::-1]:
        other = _start(level, modes)
        apart = np.abs(other[0][:, None] - found[0]).min(axis=1)
        found = np.concatenate([found, other[:, apart > ANOTHER]], axis=1)
    return found[:, np.argsort(found[0])]


def _start(level: Level, modes: int) -> Array:
    """Return log frequencies and dampings of the modes of a smoothed response, (2, modes)."""
    U, Y = level.drive, level.moved
    kernel = np.ones(SMOOTHED) / SMOOTHED

    def smoothed(values: ComplexArray) -> ComplexArray:
        return np.apply_along_axis(lambda one: np.convolve(one, kernel, "same"), 0, values)

    gram, across = U @ U.conj().transpose(0, 2, 1), Y @ U.conj().transpose(0, 2, 1)
    G = smoothed(across) @ np.linalg.inv(smoothed(gram))
    inner = slice(SMOOTHED // 2, len(G) - SMOOTHED // 2, max(1, SMOOTHED // 2))
    f, G = level.frequency_Hz[inner], G[inner].reshape(len(level.frequency_Hz[inner]), -1)
    unit_Hz = float(f[-1]) / np.pi
    s = np.asarray(1j * f / unit_Hz, dtype=np.complex128)
    size = np.sqrt((np.abs(G) ** 2).mean())
    first = start_poles(0.1 * np.pi, 1.02 * np.pi, modes, 1)
    poles = vector_fit(
        s, np.asarray(G / size, dtype=np.complex128), np.ones(G.shape), first, rounds=40
    )
    pairs = poles[poles.imag > 0]
    w, zeta = np.abs(pairs) * unit_Hz, -pairs.real / np.abs(pairs)
    kept = (zeta > LEAST_DAMPING) & (zeta < MOST_DAMPING) & (w > 10.0 * f[0])
    if not kept.any():
        raise IdentificationError(
            f"no resonance between {f[0]:.4g} and {f[-1]:.4g} Hz",
            needed="at least one",
            remedy="Fit each axis on its own with piezoid.fit.",
        )
    return np.asarray(np.log(np.stack([w[kept], zeta[kept]])))


def _low_response(problem: Problem, numbers: Numbers, residue: Array) -> Array:
    """Return the gain well below the first mode, (outputs, inputs), m/V."""
    low_Hz = np.array([0.25 * np.exp(numbers.log_frequency[0].min())])
    columns = modal_columns(
        low_Hz, numbers.log_frequency[0], numbers.log_damping[0], problem.lag_Hz
    ).value
    return np.asarray(np.einsum("fc,coi->foi", columns, residue[0])[0].real)


def _scales(problem: Problem, numbers: Numbers, residue: Array, elongation: Array) -> Array:
    """Return the rms of drives and elongations at the largest level, (2, inputs), V."""
    both = elongations_of(problem, problem.levels[-1], numbers, residue, elongation)
    return np.stack([one.std(axis=(0, 2)) for one in both])


def _with_terms(
    problem: Problem, numbers: Numbers, residue: Array, elongation: Array, scale: Array
) -> tuple[Problem, Array]:
    """Return the problem with its terms, and their linear shares, (inputs, 2, TERMS)."""
    signals = [
        [one / scale[k, :, None] for k, one in enumerate(both)]
        for both in (
            elongations_of(problem, level, numbers, residue, elongation)
            for level in problem.levels
        )
    ]
    columns = [
        np.empty((TERMS, *level.drive.shape), dtype=np.complex128) for level in problem.levels
    ]
    share = np.zeros((problem.inputs, 2, TERMS))
    for i in range(problem.inputs):
        for level, (u, s), own in zip(problem.levels, signals, columns, strict=True):
            for r in range(u.shape[2]):
                terms = hysteresis_terms(u[:, i, r], s[:, i, r], periodic=True)
                own[:, :, i, r] = at_lines(terms, level.lines).T
        share[i] = _share(problem, columns, signals, i)
        for level, (u, s), own in zip(problem.levels, signals, columns, strict=True):
            for linear, signal in zip(share[i], (u, s), strict=True):
                lines = at_lines(signal[:, i], level.lines)
                own[:, :, i] -= linear[:, None, None] * lines[None]
    levels = tuple(
        replace(level, terms=own) for level, own in zip(problem.levels, columns, strict=True)
    )
    return replace(problem, levels=levels), share


def _share(
    problem: Problem, columns: list[ComplexArray], signals: list[list[Array]], i: int
) -> Array:
    """Return the linear share of the terms of one input, all levels counting alike."""
    rows: list[list[Array]] = [[], [], []]
    for level, (u, s), own in zip(problem.levels, signals, columns, strict=True):
        kinds = (own[:, :, i], at_lines(u[:, i], level.lines), at_lines(s[:, i], level.lines))
        for gathered, kind in zip(rows, kinds, strict=True):
            flat = np.ascontiguousarray(kind.reshape(-1, level.drive[:, 0].size) / level.level_V)
            gathered.append(flat.view(np.float64).T)
    terms, u, s = (np.concatenate(gathered) for gathered in rows)
    return linear_share(terms, u[:, 0], s[:, 0])


@dataclass(frozen=True, kw_only=True, eq=False)
class _Distortion:
    """Weights of the distortion, and what they act on, level by level."""

    weight: Array
    columns: Sequence[ComplexArray]
    terms: Sequence[ComplexArray]

    def lines(self, place: int) -> ComplexArray:
        """Return what they add at one level, (lines, outputs, realisations)."""
        both = self.columns[place], self.terms[place]
        return np.asarray(np.einsum("fc,ftr,cto->for", *both, self.weight, optimize=True))


def _distortion(
    problem: Problem,
    numbers: Numbers,
    left: Sequence[ComplexArray],
    elongation: Array,
    scale: Array,
    groups: Sequence[NDArray[np.int64]],
) -> tuple[_Distortion | None, list[_Distortion | None]]:
    """Return the distortion of all realisations, and of all but each group.

    None where too few data tell it, or where groups left out are predicted no better with it.
    """
    residue = Point(problem, problem.pack(numbers)).residue
    columns, terms = [], []
    for level in problem.levels:
        columns.append(columns_at(problem, level, numbers))
        both = elongations_of(problem, level, numbers, residue, elongation)
        u, s = (one / scale[i, :, None] for i, one in enumerate(both))
        terms.append(
            np.stack(
                [
                    at_lines(distortion_terms(u[..., r], s[..., r], periodic=True), level.lines)
                    for r in range(u.shape[2])
                ],
                axis=2,
            )
        )
    rows = sum(2 * one.drive.shape[0] * one.drive.shape[2] for one in problem.levels)
    if not is_determined(columns[0].shape[1], terms[0].shape[1], rows):
        return None, [None] * len(groups)
    whole, apart = fitted_distortion(columns, terms, left, groups)
    made = [_Distortion(weight=W, columns=columns, terms=terms) for W in (whole, *apart)]
    before, after = 0.0, 0.0
    for k, rest in enumerate(left):
        size = float((np.abs(rest) ** 2).sum())
        for group, added in zip(groups, made[1:], strict=True):
            own = rest[..., group]
            before += float((np.abs(own) ** 2).sum()) / size
            after += float((np.abs(own - added.lines(k)[..., group]) ** 2).sum()) / size
    if after > WORTH**2 * before:
        return None, [None] * len(groups)
    return made[0], list(made[1:])


def _equivalent_gains(
    problem: Problem, numbers: Numbers, residue: Array, elongation: Array
) -> Array:
    """Return the regression of the terms on drive and elongation, (levels, inputs, 2), V/V."""
    found = np.zeros((len(problem.levels), problem.inputs, 2))
    for k, level in enumerate(problem.levels):
        if level.terms is None:
            continue
        signals = [
            at_lines(one, level.lines)
            for one in elongations_of(problem, level, numbers, residue, elongation)
        ]
        added = np.einsum("ik,kfir->fir", numbers.term_V, level.terms)
        for i in range(problem.inputs):
            flat = [
                np.ascontiguousarray(one[:, i].ravel()).view(np.float64)
                for one in (added, *signals)
            ]
            found[k, i] = linear_share(flat[0][:, None], flat[1], flat[2])[:, 0]
    return found


def _rms(moved_m: Array) -> Array:
    """Return the rms of each output, (outputs,), of (samples, outputs, ...)."""
    return np.asarray(np.sqrt((moved_m**2).mean(axis=(0, *range(2, moved_m.ndim)))))


def _noise(data: PeriodicData) -> Array:
    """Return the rms of a period about the mean of its realisation, (outputs,), m."""
    periods = data.displacement_m.shape[3]
    if periods < 2:
        return np.zeros(len(data.outputs))
    apart = data.displacement_m - data.displacement_m.mean(axis=3, keepdims=True)
    return _rms(apart) * float(np.sqrt(periods / (periods - 1)))
