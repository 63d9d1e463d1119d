"""Simulate coupled axes in closed loop at the same time, behind the decoupling matrix.

    y'_i = P_i u_i + sum_(j != i) T_ij P_j u_j,   T_ij = [D G]_ij / [D G]_jj

P_i is the identified axis with its hysteresis and its compiled controller. The loops are simulated
one after the other with the coupled motion of the other axes added, until it converges: waveform
relaxation [Lelarasmee, Ruehli & Sangiovanni-Vincentelli 1982].
"""

import numpy as np

from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.verification.closed_loop import approach_path, run_axis
from piezoid.verification.scenario_runner import ScenarioRunner
from piezoid.verification.verification import CouplingRow

_PERIODS = 4  # of the motion; the first is discarded
_TOLERANCE = 1e-3  # of the motion, between two iterations
_MAX_ITERATIONS = 12
_DIVERGED = 1e3  # times the motion
# Of the gain at rest: T_ij is regularised at frequencies where the axis hardly responds.
_MIN_GAIN = 0.05


def coupling_rows(runner: ScenarioRunner, coupled: CoupledStage | None) -> tuple[CouplingRow, ...]:
    """Return the remaining coupling in closed loop, where all coupled axes ship."""
    decoupled = runner.file.decoupled
    if coupled is None or decoupled is None or set(decoupled.axes) - set(runner.lateral):
        return ()
    axes, D = decoupled.axes, decoupled.matrix
    samples = round(_PERIODS * runner.rate_Hz / runner.limits.judged_Hz)
    # Lines of twice the record, to avoid circular convolution.
    f = np.asarray(np.arange(samples + 1) * runner.rate_Hz / (2 * samples))
    level_V = float(np.sqrt(coupled.levels_V[0] * coupled.levels_V[-1]))
    G = coupled.response(np.clip(f, *coupled.band_Hz), level_V)
    G[f > coupled.band_Hz[1]] = 0.0
    rows = []
    for k, driven in enumerate(axes):
        percent = _amplitudes(runner, axes, k, D, _transmission(D @ G))
        without_percent = _amplitudes(runner, axes, k, np.eye(len(axes)), _transmission(G))
        if percent is None:
            continue
        rows += [
            CouplingRow(
                moved=driven,
                answers=axis,
                frequency_Hz=runner.limits.judged_Hz,
                percent=float(percent[i]),
                without_percent=None if without_percent is None else float(without_percent[i]),
            )
            for i, axis in enumerate(axes)
            if i != k
        ]
    return tuple(rows)


def _transmission(response: ComplexArray) -> ComplexArray:
    """Return T, (lines, axes, axes), 0 on the diagonal."""
    direct = np.einsum("fjj->fj", response)
    floor = (_MIN_GAIN * np.abs(direct[1])) ** 2
    T = response * (direct.conj() / (np.abs(direct) ** 2 + floor))[:, None, :]
    return np.asarray(T * (1.0 - np.eye(response.shape[1])))


def _amplitudes(
    runner: ScenarioRunner, axes: tuple[str, ...], driven: int, D: Array, T: ComplexArray
) -> Array | None:
    """Return the amplitude of each axis in percent of the driven axis; None if it diverges."""
    samples = len(T) - 1
    time_s = np.arange(samples) / runner.rate_Hz
    sine = np.sin(2.0 * np.pi * runner.limits.judged_Hz * time_s)
    amplitude_m = runner.radius_m / float(np.abs(D[:, driven]).max())
    reference_m = np.stack(
        [runner.centre_m[a] + amplitude_m * D[i, driven] * sine for i, a in enumerate(axes)]
    )
    coupled_m = np.zeros_like(reference_m)
    for _ in range(_MAX_ITERATIONS):
        # the motion of each axis by its drive, with the coupled motion of the other axes
        driven_m = np.empty_like(reference_m)
        for i, axis in enumerate(axes):
            plant = runner.plants[axis]
            approach = approach_path(plant, float(reference_m[i, 0]))
            record = run_axis(
                plant,
                runner.file.axis(axis),
                np.concatenate([approach, reference_m[i]]),
                rng=np.random.default_rng(runner.seed),
                added_m=np.concatenate([np.full(len(approach), coupled_m[i, 0]), coupled_m[i]]),
            )
            position_m = record.after(len(approach)).position
            driven_m[i] = position_m - coupled_m[i] - runner.centre_m[axis]
        lines = np.fft.rfft(driven_m, 2 * samples, axis=1)
        previous_m = coupled_m
        coupled_m = np.fft.irfft(np.einsum("fij,jf->if", T, lines), 2 * samples, axis=1)
        coupled_m = coupled_m[:, :samples]
        change_m = float(np.abs(coupled_m - previous_m).max())
        if change_m > _DIVERGED * amplitude_m:
            return None
        if change_m < _TOLERANCE * amplitude_m:
            break
    else:
        return None
    sensed_m = np.linalg.solve(D, driven_m + coupled_m)[:, samples // _PERIODS :]
    deviation_m = (sensed_m - sensed_m.mean(axis=1)[:, None]).std(axis=1)
    return np.asarray(100.0 * np.sqrt(2.0) * deviation_m / amplitude_m)
