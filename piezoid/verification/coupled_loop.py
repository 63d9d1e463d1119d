"""Coupled axes under their controllers at the same time, the decoupling matrix in front.

    y'_i = P_i u_i + sum_(j != i) T_ij P_j u_j,   T_ij = [D G]_ij / [D G]_jj

P_i is the identified axis with its hysteresis and its compiled controller. The loops are run one
after the other with what the others moved, again and again until nothing changes: waveform
relaxation [Lelarasmee, Ruehli & Sangiovanni-Vincentelli 1982].
"""

import numpy as np

from piezoid.identification.coupled.coupled_stage import CoupledStage
from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.verification.closed_loop import run_axis
from piezoid.verification.criteria import Verdict
from piezoid.verification.scenario_runner import ScenarioRunner
from piezoid.verification.start_position import approach_path
from piezoid.verification.verification import CouplingRow

PERIODS = 4  # of the motion, the first of which does not count
SETTLED = 1e-3  # of the motion, between two rounds
ROUNDS = 12
# Of the gain at rest: where an axis hardly answers to its drive, what others do is not told by it
LEAST_GAIN = 0.05


def coupling_rows(bench: ScenarioRunner, coupled: CoupledStage | None) -> tuple[CouplingRow, ...]:
    """Return what the coupling leaves in closed loop, where all coupled axes ship."""
    decoupled = bench.file.decoupled
    if coupled is None or decoupled is None or set(decoupled.axes) - set(bench.lateral):
        return ()
    axes, D = decoupled.axes, decoupled.matrix
    level_V = float(np.sqrt(coupled.levels_V[0] * coupled.levels_V[-1]))
    f = _frequencies(bench)
    G = coupled.response(
        np.minimum(np.maximum(f, coupled.band_Hz[0]), coupled.band_Hz[1]), level_V
    )
    G[f > coupled.band_Hz[1]] = 0.0
    rows = []
    for k, moved in enumerate(axes):
        behind = _answers(bench, axes, k, D, _transmission(D @ G))
        bare = _answers(bench, axes, k, np.eye(len(axes)), _transmission(G))
        for i, answers in enumerate(axes):
            if i == k or behind is None:
                continue
            rows.append(
                CouplingRow(
                    moved=moved,
                    answers=answers,
                    frequency_Hz=bench.limits.judged_Hz,
                    percent=float(behind[i]),
                    without_percent=None if bare is None else float(bare[i]),
                )
            )
    return tuple(rows)


def coupling_verdict(rows: tuple[CouplingRow, ...], limit_percent: float) -> Verdict:
    """Judge the largest motion of an axis that the coupling left to it."""
    return Verdict(
        name="motion of an axis while another one moves",
        scenario="coupled axes",
        value=max(row.percent for row in rows),
        limit=limit_percent,
        unit="% of the motion",
    )


def _samples(bench: ScenarioRunner) -> int:
    return round(PERIODS * bench.rate_Hz / bench.limits.judged_Hz)


def _frequencies(bench: ScenarioRunner) -> Array:
    """Return the lines of twice the record, so that its end does not meet its beginning."""
    count = _samples(bench)
    return np.asarray(np.arange(count + 1) * bench.rate_Hz / (2 * count))


def _transmission(response: ComplexArray) -> ComplexArray:
    """Return T, (lines, axes, axes), 0 on the diagonal."""
    own = np.einsum("fjj->fj", response)
    floor = (LEAST_GAIN * np.abs(own[1])) ** 2
    found = response * (own.conj() / (np.abs(own) ** 2 + floor))[:, None, :]
    found *= 1.0 - np.eye(response.shape[1])
    return np.asarray(found)


def _answers(
    bench: ScenarioRunner, axes: tuple[str, ...], moved: int, D: Array, T: ComplexArray
) -> Array | None:
    """Return the amplitude of every axis in percent of that of one; None: they do not settle."""
    samples = _samples(bench)
    time_s = np.arange(samples) / bench.rate_Hz
    way = np.sin(2.0 * np.pi * bench.limits.judged_Hz * time_s)
    reach_m = bench.radius_m / float(np.abs(D[:, moved]).max())
    reference = {
        axis: bench.centre_m[axis] + reach_m * D[i, moved] * way for i, axis in enumerate(axes)
    }
    shift = {axis: np.zeros(samples) for axis in axes}
    for _ in range(ROUNDS):
        own = {axis: _own(bench, axis, reference[axis], shift[axis]) for axis in axes}
        lines = np.fft.rfft(np.stack([own[axis] for axis in axes]), 2 * samples, axis=1)
        passed = np.fft.irfft(np.einsum("fij,jf->if", T, lines), 2 * samples, axis=1)[:, :samples]
        new = dict(zip(axes, passed, strict=True))
        change_m = max(float(np.abs(new[axis] - shift[axis]).max()) for axis in axes)
        shift = new
        if change_m > 1e3 * reach_m:
            return None
        if change_m < SETTLED * reach_m:
            break
    else:
        return None
    whole = np.stack([own[axis] + shift[axis] for axis in axes])
    seen = np.linalg.solve(D, whole)[:, samples // PERIODS :]
    return np.asarray(
        100.0 * np.sqrt(2.0) * (seen - seen.mean(axis=1)[:, None]).std(axis=1) / reach_m
    )


def _own(bench: ScenarioRunner, axis: str, reference_m: Array, shift_m: Array) -> Array:
    """Return what an axis moves by itself, about its centre, while others move it by a shift."""
    plant = bench.plants[axis]
    way = approach_path(plant, float(reference_m[0]))
    record = run_axis(
        plant,
        bench.file.axis(axis),
        np.concatenate([way, reference_m]),
        rng=np.random.default_rng(bench.seed),
        beside=np.concatenate([np.full(len(way), shift_m[0]), shift_m]),
    )
    return np.asarray(record.after(len(way)).position - shift_m - bench.centre_m[axis])
