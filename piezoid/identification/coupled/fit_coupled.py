"""fit_coupled: periodic records of a stage with several drives, at several levels -> CoupledStage.

    min sum_r w_r |Y_r - e^(-s delay) G(s, l) U_r|^2

over all excited lines. Residues are linear and eliminated [Golub & Pereyra 1973]; poles and delay
are searched for. Starts: vector fitting for the largest level, its poles for the smallest, a
straight line between them. The weight w_r of a realisation is one over the residual power of a
first fit, so that disturbed realisations count less.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from piezoid.errors import ExcitationError, IdentificationError
from piezoid.identification.coupled.coupled_stage import CoupledStage, ModalShape
from piezoid.identification.coupled.modal_fit import (
    LevelSpectra,
    ModalProblem,
    fit_modal_sum,
    residual_spectra,
)
from piezoid.identification.dynamics.periodic_estimate import PeriodicData
from piezoid.identification.dynamics.vector_fitting import start_poles, vector_fit
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.numerics.executor import on_one_thread
from piezoid.numerics.levenberg_marquardt import Rule

LAGS_PER_DECADE = 1.3  # real poles below the first mode, for creep
SMOOTHED_LINES = 5  # of the response that the start is fitted to: single lines give poles of noise
START_DAMPING = (0.003, 0.3)  # below, a pole follows noise; above, a slope
DISTINCT = 0.02  # relative distance of modes: levels of 1 to 3 move one by up to half as much
FINAL_RULE = Rule(tolerance=2e-3, iterations=12)
JACKKNIFE_RULE = Rule(tolerance=2e-3, iterations=3)


@on_one_thread
def fit_coupled(
    levels: Sequence[PeriodicData], *, modes: int = 20, intervals: bool = True
) -> CoupledStage:
    """Fit one linear model to the steady answers of a stage at one or several levels of the drive.

    levels     periodic records with the same lines, inputs and outputs, one for each level; more
               realisations than inputs in each
    modes      pairs of poles that the start may have; those that follow noise are left out of it
    intervals  fit again without each realisation, for the jackknife; about twice as long again

    Y = e^(-s delay) G(s, level) U, as of ``CoupledStage``. Distortion counts as noise that is
    independent in each realisation [Pintelon & Schoukens 2012].

    Raises ``ExcitationError`` for records that differ in more than their level, or for too few
    realisations; ``IdentificationError`` where no start has a mode in the band.

    >>> coupled = piezoid.fit_coupled(levels, modes=2, intervals=False)
    >>> coupled.inputs, coupled.outputs
    (('x',), ('x',))
    """
    data = sorted(levels, key=lambda level: float(level.voltage_V.std()))
    _check_levels(data)
    problem, shape, residues = _fit_all_levels(data, modes)
    count = min(level.voltage_V.shape[2] for level in data)
    is_left_out = intervals and count > len(data[0].inputs) + 1
    fits = [(shape, residues)] * count
    if is_left_out:
        for r in range(count):
            remaining = tuple(level.without(r) for level in problem.levels)
            fits[r] = fit_modal_sum(replace(problem, levels=remaining), shape, JACKKNIFE_RULE)
    errors_m = []
    for level in problem.levels:
        power = [
            (np.abs(residual_spectra(problem, level, *fit)[..., r]) ** 2).sum(axis=0)
            for r, fit in enumerate(fits)
        ]
        errors_m.append(np.sqrt(2.0 * np.mean(power, axis=0)) / level.samples)
    noise_m = []
    for level_data in data:  # of a period about the mean of its realisation
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
        residue_m_per_V=residues,
        delay_s=shape.delay_s,
        replicate_frequency=np.stack(
            [fit.log_frequency for fit, _ in (fits if is_left_out else fits[:1])]
        ),
        moved_rms_m=np.stack(
            [_rms(level.displacement_m - level.displacement_m.mean(axis=0)) for level in data]
        ),
        noise_rms_m=np.stack(noise_m),
        error_rms_m=np.stack(errors_m),
        error_is_left_out=is_left_out,
    )


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
                remedy="Fit them apart, or record all levels alike.",
            )
        if level.voltage_V.shape[2] <= len(level.inputs):
            raise ExcitationError(
                f"{level.voltage_V.shape[2]} realisations for {len(level.inputs)} drives",
                needed=f"at least {len(level.inputs) + 1}: distortion is what they differ in",
                remedy="Record more realisations of the multisine.",
            )


def _fit_all_levels(
    data: Sequence[PeriodicData], modes: int
) -> tuple[ModalProblem, ModalShape, Array]:
    """Fit the largest level, then the smallest from there, then all of them, reweighted."""
    levels = tuple(LevelSpectra.of(level) for level in data)
    # A weak mode beside a strong one may be visible at one level only.
    poles = _start_of_level(levels[-1], modes)
    for level in levels[-2::-1]:
        new_modes = _start_of_level(level, modes)
        distance = np.abs(new_modes[0][:, None] - poles[0]).min(axis=1)
        poles = np.concatenate([poles, new_modes[:, distance > DISTINCT]], axis=1)
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
    still = np.zeros(count)
    shape = ModalShape(
        log_frequency=np.stack([poles[0], still]),
        log_damping=np.stack([poles[1], still]),
        delay_s=0.0,
    )
    largest, residues = fit_modal_sum(replace(problem, levels=levels[-1:]), shape, FINAL_RULE)
    if len(levels) == 1:
        return problem, largest, residues
    smallest, _ = fit_modal_sum(replace(problem, levels=levels[:1]), largest, FINAL_RULE)
    shape = replace(
        largest,
        log_frequency=_line(smallest.log_frequency[0], largest.log_frequency[0]),
        log_damping=_line(smallest.log_damping[0], largest.log_damping[0]),
    )
    shape, residues = fit_modal_sum(problem, shape, FINAL_RULE)
    # Each realisation counts by one over the power of its residual.
    residuals = [residual_spectra(problem, level, shape, residues) for level in levels]
    reweighted = tuple(
        replace(level, weight=1.0 / (np.abs(residual) ** 2).sum(axis=(0, 1)))
        for level, residual in zip(levels, residuals, strict=True)
    )
    problem = replace(problem, levels=reweighted)
    return problem, *fit_modal_sum(problem, shape, FINAL_RULE)


def _line(low: Array, high: Array) -> Array:
    """Return middle and half difference; a mode whose partner moved away stays where it was."""
    difference = np.where(np.abs(high - low) < 0.5, high - low, 0.0)
    return np.stack([high - difference / 2, difference / 2])


def _start_of_level(level: LevelSpectra, modes: int) -> Array:
    """Return log frequencies and dampings of the modes of a smoothed response, (2, modes)."""
    U, Y = level.drive, level.displacement
    kernel = np.ones(SMOOTHED_LINES) / SMOOTHED_LINES

    def smoothed(values: ComplexArray) -> ComplexArray:
        return np.apply_along_axis(lambda column: np.convolve(column, kernel, "same"), 0, values)

    gram, cross = U @ U.conj().transpose(0, 2, 1), Y @ U.conj().transpose(0, 2, 1)
    G = smoothed(cross) @ np.linalg.inv(smoothed(gram))
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
            remedy="Fit each axis on its own with piezoid.fit.",
        )
    return np.asarray(np.log(np.stack([frequency_Hz[is_mode], damping[is_mode]])))


def _rms(moved_m: Array) -> Array:
    """Return the rms of each output, (outputs,), of (samples, outputs, ...)."""
    return np.asarray(np.sqrt((moved_m**2).mean(axis=(0, *range(2, moved_m.ndim)))))
