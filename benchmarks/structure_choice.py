"""How many modes: judged on realisations the fit has not seen."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.fit_dynamics import Declaration, fit_dynamics
from piezoid.identification.dynamics.frequency_response import ComplexArray, FrequencyResponse
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Structure
from piezoid.identification.dynamics.periodic_estimate import PeriodicData
from piezoid.numerics.arrays import Array

AS_GOOD = 0.01  # a structure whose held-out error is within 1 % of the best counts as equal


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One structure, fitted and judged.

    held_out_relative_rms  rms of what the model leaves on held-out data over that data's rms;
                           infinite where the fit was refused
    cost_ratio             cost over its expected value on the data it was fitted to
    parameters             gains of all paths and shared shapes
    reason                 why the fit was refused, empty otherwise
    """

    structure: Structure
    held_out_relative_rms: float
    cost_ratio: float
    parameters: int
    reason: str = ""


@dataclass(frozen=True, kw_only=True, eq=False)
class StructureChoice:
    """All trials in the order they were asked for, and the model that was chosen."""

    trials: tuple[Trial, ...]
    chosen: LinearDynamics
    structure: Structure


def choose_structure(
    measured: FrequencyResponse,
    held_out: PeriodicData,
    structures: Sequence[Structure],
    declaration: Declaration,
) -> StructureChoice:
    """Fit every structure, and keep the smallest that is as good as the best on held-out data.

    measured    from the realisations to fit
    held_out    other realisations of the same lines

    The best error is the smallest of several, hence a little flattering. A cost ratio far above
    one beside a small held-out error means that the variances are too small, or that what is left
    is not linear.
    """
    trials, models = [], {}
    for structure in structures:
        try:
            model = fit_dynamics(measured, structure, declaration)
        except IdentificationError as refusal:
            trials.append(_refused(structure, str(refusal)))
            continue
        models[structure] = model
        values = model.response_as_measured(measured.frequency_Hz)
        trials.append(
            Trial(
                structure=structure,
                held_out_relative_rms=relative_rms(values, measured.frequency_Hz, held_out),
                cost_ratio=model.cost_ratio,
                parameters=structure.columns * values[0].size + structure.shapes,
            )
        )
    if not models:
        raise IdentificationError(
            f"none of {len(trials)} structures could be fitted; the last: {trials[-1].reason}",
            needed="at least one that the data determines",
            remedy="Offer smaller structures, or measure more lines.",
        )
    best = min(trial.held_out_relative_rms for trial in trials)
    good = [t for t in trials if t.held_out_relative_rms <= best * (1 + AS_GOOD)]
    chosen = min(good, key=lambda trial: trial.parameters).structure
    return StructureChoice(trials=tuple(trials), chosen=models[chosen], structure=chosen)


def _refused(structure: Structure, reason: str) -> Trial:
    return Trial(
        structure=structure,
        held_out_relative_rms=float("inf"),
        cost_ratio=float("inf"),
        parameters=0,
        reason=reason,
    )


def relative_rms(response: ComplexArray, frequency_Hz: Array, data: PeriodicData) -> float:
    """Return the rms of Y - G U over the rms of Y, over all outputs, lines and realisations.

    response      (lines, outputs, inputs)  of a model, or a measured one for comparison
    frequency_Hz  (lines,)                  which must be lines of the data
    data          its periods are averaged

    By Parseval's theorem this is the relative rms of the steady displacement in those lines.
    """
    resolution_Hz = data.sampling_rate_Hz / len(data.voltage_V)
    lines = np.round(frequency_Hz / resolution_Hz).astype(np.int64)
    if np.abs(lines * resolution_Hz - frequency_Hz).max() > 1e-6 * resolution_Hz:
        raise ValueError(f"frequency_Hz must be multiples of {resolution_Hz:g} Hz")
    drive, moved = data.spectra(lines)
    Y = moved.mean(axis=3)
    left = Y - response @ drive.mean(axis=3)
    return float(np.linalg.norm(left) / np.linalg.norm(Y))
