"""fit_extended: joint refit of an axis model and its extensions, with cross-validation.

It is the search of the hysteresis fit, with the numbers of extensions as further parameters. The
refit without a fold starts from the fit to all rows.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.extensions.extension import Extension
from piezoid.identification.hysteresis.coordinates import to_si_units
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, minimise, residuals
from piezoid.identification.joint.vector import Structure, parts_of, task_of
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import BLOCKS, FOLDS, IN_SAMPLE, with_noise_bound
from piezoid.numerics.arrays import Array, Samples
from piezoid.numerics.levenberg_marquardt import Rule
from piezoid.records.recording import Recording

MAX_STEPS = 10
RULE = Rule(tolerance=1e-4, tries=8, damping=1e-4)
FOLD_STEPS = (
    1  # of a fit without a fold: with two or three, held-out errors differ by 0.4 to 3.4 %
)
FULL_STRUCTURE = Structure()


@dataclass(frozen=True, kw_only=True, eq=False)
class Extended:
    """Result of a joint fit.

    model           fitted axis with its extensions
    rms_m           residual at all rows
    held_out_rms_m  error at left-out rows
    held_m          (rows,)  error at left-out rows
    spread          standard errors of the numbers of each extension, from leaving out folds
    converged       whether the last step hardly changed the error
    """

    model: AxisModel
    rms_m: float
    held_out_rms_m: float
    held_m: Array
    spread: tuple[Array, ...]
    converged: bool


def fit_extended(
    model: AxisModel,
    recordings: Sequence[Recording],
    extensions: Sequence[Extension] = (),
    *,
    further_starts: Sequence[AxisModel] = (),
    structure: Structure = FULL_STRUCTURE,
    samples: Sequence[Samples] | None = None,
    ringing: Sequence[Extension] = (),
    steps: int = MAX_STEPS,
) -> Extended:
    """Refit weights, thresholds, memory and zero of an axis together with extensions.

        min over all parameters of sum over rows of (simulated - measured)^2

    model           fitted axis: start of the search, with its numbers of plays and dead zones
    recordings      of this axis; recordings that the model does not contain start with all
                    plays at the first drive
    extensions      with start values near the true ones
    further_starts  further models to start from, because thresholds have many local minima; only
                    the closest fit is returned and cross-validated
    structure       components of the hysteresis that are fitted
    samples         samples that may be fitted, for each piece; None: all, thinned evenly
    ringing         further modes whose unresolved ringing is excluded, as that of ``extensions``:
                    errors of several fits are comparable only over the same samples

    Every piece has one constant zero; ``ThermalDrift`` represents slow motion. The held-out error
    is that of blocks of several seconds that are excluded from the fit of all parameters, but not
    from the simulation. A parameter that the rows do not determine keeps its start value, and a
    mode that starts more than its width from the true frequency is not found.
    """
    searches = []
    for start in (model, *further_starts):
        parts = parts_of(start, recordings, samples, (*extensions, *ringing))
        task, theta = task_of(start, parts, extensions, structure)
        fit = minimise(theta, task, iterations=steps, rule=RULE)
        searches.append((start, parts, fit, fit.rms * abs(task.scales.displacement_m)))
    start, parts, fit, rms_m = min(searches, key=lambda search: search[3])
    refits: list[Array] = []
    errors: list[Array] = []
    for fold in range(FOLDS):
        training = [part.samples[part.fold != fold] for part in parts]
        held_out = [part.samples[part.fold == fold] for part in parts]
        refit = minimise(
            fit.theta, replace(fit.task, samples=training), iterations=FOLD_STEPS, rule=RULE
        )
        refits.append(refit.theta)
        errors += residuals(refit.theta, replace(fit.task, samples=held_out))
    held_m = np.concatenate(errors) * abs(fit.task.scales.displacement_m)
    # Standard errors from leaving out folds: (F - 1) / sqrt(F) times their scatter.
    std = np.std(refits, axis=0, ddof=1) * (FOLDS - 1) / np.sqrt(FOLDS)
    return Extended(
        model=_model(start, fit, std, held_m),
        rms_m=rms_m,
        held_out_rms_m=float(np.sqrt(np.mean(held_m**2))),
        held_m=held_m,
        spread=tuple(std[numbers] for numbers in fit.task.coordinates.extension_slices),
        converged=fit.converged,
    )


def _model(model: AxisModel, fit: HysteresisFit, std: Array, held_m: Array) -> AxisModel:
    """Return the axis model with the parameters at the end of a search.

    std     (total,)  standard errors
    held_m  (rows,)   error at left-out rows
    """
    task, operator, scales = fit.task, fit.operator, fit.task.scales
    starts = fit.starts(scales)
    uncertainty, lag = model.uncertainty, task.coordinates.slices["lag"]
    if lag.stop > lag.start:  # the previous fit may have lacked a mode
        uncertainty = uncertainty.updated("lag_s", operator.lag_s, float(std[lag][0]))
    rms_m = fit.rms * abs(scales.displacement_m)
    is_tested = model.quality.is_tested
    return replace(
        model,
        hysteresis=to_si_units(
            operator, scales, float(np.mean([s.zero_m.mean() for s in starts]))
        ),
        lag=Lag(kind=fit.shape.lag, time_s=operator.lag_s),
        extensions=tuple(
            replace(extension, std=tuple(std[numbers].tolist()))
            for extension, numbers in zip(
                task.extensions_at(fit.theta), task.coordinates.extension_slices, strict=True
            )
        ),
        starts=starts,
        uncertainty=uncertainty,
        quality=with_noise_bound(
            replace(
                model.quality,
                rms_m=rms_m,
                held_out_rms_m=float(np.sqrt(np.mean(held_m**2))) if is_tested else rms_m,
                held_out_kind=BLOCKS if is_tested else IN_SAMPLE,
                rows=task.rows,
                effective_parameters=float(len(fit.theta)),
                converged=fit.converged,
            )
        ),
        certificate=replace(
            model.certificate, remainder_m=float(np.quantile(np.abs(held_m), 0.999))
        ),
    )
