"""Estimate the hysteresis of one axis: from its recordings to an AxisModel."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.applicability import (
    limits_of_lag,
    reason_in_loops,
    reason_of_error,
    reason_of_no_response,
)
from piezoid.identification.hysteresis.coordinates import Shape, to_si_units
from piezoid.identification.hysteresis.cycles import (
    cycles_of,
    limits_of_cycles,
    trends_over_cycles,
)
from piezoid.identification.hysteresis.excluded_rows import without_outliers, without_transients
from piezoid.identification.hysteresis.gauss_newton import HysteresisFit, minimise
from piezoid.identification.hysteresis.order_selection import (
    ORDERS,
    Choice,
    choose_shape,
    without_bends,
)
from piezoid.identification.hysteresis.pieces import (
    Piece,
    Rig,
    Scales,
    longest_lag_s,
    pieces_of,
    response_range,
    scales_of,
)
from piezoid.identification.hysteresis.scope import limits_as_recorded
from piezoid.identification.hysteresis.search import (
    Settings,
    prune,
    search,
    search_from,
)
from piezoid.identification.hysteresis.sensor_noise import sensor_noise
from piezoid.identification.hysteresis.uncertainty import certify, jackknife, summarise
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import (
    IN_SAMPLE,
    SECOND_HALF,
    FitQuality,
    Order,
    Verdict,
)
from piezoid.numerics.arrays import Array
from piezoid.operators.play import forgetting_sample
from piezoid.records.recording import Recording

FIRST_SHAPE = Shape(plays=8, below=2, above=2)
CHOOSING_ROWS = 4000
FINAL_ROWS = 40_000
MAX_KKT_GAP = 1e-6  # of the quadratic program that the search starts from
POLISHING_ITERATIONS = 4  # over every row, after the search over thinned rows
Progress = Callable[[str], None]
Orders = Sequence[tuple[int, int]]


def estimate_axis(
    recordings: Sequence[Recording],
    axis: str,
    rig: Rig,
    *,
    orders: Orders = ORDERS,
    progress: Progress = lambda _: None,
) -> AxisModel:
    """Fit one axis: convex start, Gauss-Newton, order by held-out error, uncertainty, verdict.

    recordings  of this axis, each with its own memory and zero; only the order of ``starts``
                depends on theirs
    axis        name
    rig         poles that the laboratory declares
    orders      (plays, dead zones per side) to choose from
    progress    called with a description of each step

    Raises ``ExcitationError`` if drive or displacement does not move.
    """
    # The folds depend on the order of the recordings, and so do the last digits of sums over rows.
    ordered = tuple(sorted(recordings, key=lambda recording: recording.name))
    progress("first fit")
    scales = scales_of(ordered, axis)
    pieces = pieces_of(ordered, axis, scales, rig)
    coarse = Settings(
        longest_lag_s=longest_lag_s(pieces),
        sensor_pole_Hz=rig.sensor_bandwidth_Hz,
        rows=CHOOSING_ROWS,
        iterations=12,
    )
    fit = search(pieces, FIRST_SHAPE, coarse)
    pieces, outliers = without_outliers(fit)
    if outliers:
        fit = search(pieces, FIRST_SHAPE, coarse)
    pieces = without_transients(fit)
    coarse = replace(coarse, lag_s=fit.operator.lag_s)
    loop_reason = reason_in_loops(pieces)
    if loop_reason:  # one small fit is enough to show how wrong the class is
        orders = orders[:1]
    choice = choose_shape(pieces, coarse, orders=orders, progress=progress)
    cycles = [c for c in map(cycles_of, pieces) if c is not None]
    slides = limits_of_cycles(cycles)
    # A lag or gain that changes from cycle to cycle dominates the residual and hides the
    # difference between plays and a lag.
    has_trend = bool(slides) or any(c.gain is not None for c in cycles)
    limits, lag_reason = limits_of_lag(pieces, choice, coarse.longest_lag_s, progress)
    if has_trend:
        lag_reason = ""
    if lag_reason:
        choice = without_bends(choice)
    rejection = (
        reason_of_no_response(pieces, choice, scales)
        or lag_reason
        or loop_reason
        or reason_of_error(pieces, choice)
    )
    progress("final fit")
    fit = _final_fit(pieces, choice, replace(coarse, rows=FINAL_ROWS, iterations=30))
    limits = (*limits, *limits_as_recorded(ordered, axis), *slides)
    stroke_m = abs(scales.displacement_m)
    quality = replace(
        _quality(fit, choice, pieces, stroke_m),
        limits=tuple(sorted(limits, key=lambda limit: limit.most)),
    )
    noise = quality.noise_rms_m / stroke_m
    trends = [text for c in cycles for text in trends_over_cycles(c, stroke_m, noise)]
    remarks = (*outliers, *trends, *remarks_on(fit, choice.kind, rig))
    verdict = Verdict(applies=not rejection, reason=rejection, remarks=remarks)
    model = _axis_model(ordered, axis, rig, scales, fit, choice.best.residual, verdict, quality)
    names = [recording.name for recording in recordings]
    starts = tuple(sorted(model.starts, key=lambda start: names.index(start.recording)))
    return replace(model, starts=starts)


def _final_fit(pieces: Sequence[Piece], choice: Choice, settings: Settings) -> HysteresisFit:
    """Fit the chosen shape to all rows.

    An error in sample above the held-out error of the folds shows that a better minimum exists:
    the search is then repeated from the operators of the folds.
    """
    best = choice.best
    fit = search(pieces, best.shape, settings)
    if fit.rms > best.held_out_rms:
        repeated = (
            search_from(pieces, operator, best.shape.lag, settings) for operator in best.operators
        )
        closest = min((fit, *repeated), key=lambda candidate: candidate.rms)
        fit = replace(closest, kkt_gap=fit.kkt_gap)
    fit = prune(fit, iterations=settings.iterations)
    all_rows = replace(fit.task, samples=[piece.fitted_samples() for piece in pieces])
    if all_rows.rows == fit.task.rows:
        return fit
    polished = minimise(fit.theta, all_rows, iterations=POLISHING_ITERATIONS, kkt_gap=fit.kkt_gap)
    return replace(polished, task=fit.task)


def _axis_model(
    recordings: Sequence[Recording],
    axis: str,
    rig: Rig,
    scales: Scales,
    fit: HysteresisFit,
    held_out: Array,
    verdict: Verdict,
    quality: FitQuality,
) -> AxisModel:
    """Return the model of a fit in SI units with its uncertainty.

    held_out  (rows,)  held-out residual, scaled units
    """
    theta, coordinates = fit.theta, fit.task.coordinates
    refits = jackknife(theta, fit.task)
    starts = fit.starts(scales)
    drives = [recording.voltage_V(axis) for recording in recordings]
    fitted_V = [
        drives[piece.recording][piece.begin + piece.first : piece.begin + piece.last]
        for piece in fit.task.pieces
    ]
    slew_V_per_s = max(
        float(np.abs(np.diff(u)).max()) * piece.sampling_rate_Hz
        for u, piece in zip(fitted_V, fit.task.pieces, strict=True)
    )
    zero_m = float(np.mean([start.zero_m.mean() for start in starts]))
    residual_m = held_out * abs(scales.displacement_m)
    longest_s = fit.task.longest_lag_s
    return AxisModel(
        axis=axis,
        hysteresis=to_si_units(fit.operator, scales, zero_m),
        polarity=int(np.sign(scales.displacement_m)),
        lag=Lag(kind=fit.shape.lag, time_s=fit.operator.lag_s),
        rig=rig,
        starts=starts,
        voltage_V=(min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)),
        verdict=verdict,
        quality=quality,
        uncertainty=summarise(refits, coordinates, scales),
        certificate=certify(refits, coordinates, scales, residual_m, slew_V_per_s, longest_s),
    )


def remarks_on(fit: HysteresisFit, held_out_kind: str, rig: Rig) -> tuple[str, ...]:
    """Return remarks on excitation, on weights and lags at their bounds, and on the start."""
    remarks = []
    if held_out_kind == SECOND_HALF:
        remarks.append(
            "The numbers of plays and dead zones were chosen by the error on the second half of "
            "the only recording that determines the hysteresis."
        )
    if held_out_kind == IN_SAMPLE:
        remarks.append(
            "The error is in sample: a single loop leaves nothing to test the model on."
        )
    operator, plays = fit.operator, fit.shape.plays
    for piece in fit.task.pieces:
        drive = piece.fitted_drive
        unexcited = int((forgetting_sample(drive, operator.threshold) >= len(drive)).sum())
        if unexcited:
            remarks.append(
                f"{piece.name} is too small to move the {unexcited} widest of the {plays} plays: "
                "only other recordings determine them."
            )
    on_zero = int((operator.weight[1:] <= 0.0).sum())
    if on_zero:
        remarks.append(f"{on_zero} of {plays} play weights lie on 0; only upper limits are given.")
    if fit.shape.lag != "none" and operator.lag_s <= 0.0:
        poles = (rig.amplifier_bandwidth_Hz, rig.sensor_bandwidth_Hz)
        declared = ", ".join(with_unit(pole, "Hz") for pole in poles if pole is not None)
        check = "that both channels are sampled at the same instant"
        if declared:
            remarks.append(
                f"The fitted lag lies on 0: the declared poles ({declared}) delay at least as "
                "much as the recordings show. Check bandwidth_Hz of [amplifier] and [sensor], "
                f"and {check}."
            )
        else:
            remarks.append(
                f"The fitted lag lies on 0: the displacement may lead the drive. Check {check}."
            )
    if fit.shape.lag != "none" and operator.lag_s >= 0.999 * fit.task.longest_lag_s > 0.0:
        bound = with_unit(operator.lag_s, "s")
        remarks.append(f"The fitted lag lies on its upper bound, {bound}.")
    if fit.kkt_gap > MAX_KKT_GAP:
        remarks.append(f"The convex start is optimal only to {fit.kkt_gap:.1e}.")
    return tuple(remarks)


def _quality(
    fit: HysteresisFit, choice: Choice, pieces: Sequence[Piece], stroke_m: float
) -> FitQuality:
    residuals = [fit.simulate(index, piece) - piece.response for index, piece in enumerate(pieces)]
    noise, is_bound = zip(*map(sensor_noise, pieces, residuals), strict=True)
    rows = [piece.rows for piece in pieces]
    return FitQuality(
        rms_m=fit.rms * stroke_m,
        held_out_rms_m=choice.best.held_out_rms * stroke_m,
        held_out_kind=choice.kind,
        range_m=response_range(pieces) * stroke_m,
        noise_rms_m=stroke_m * float(np.sqrt(np.average(np.square(noise), weights=rows))),
        noise_is_most=any(is_bound),
        rows=sum(rows),
        effective_parameters=float(len(fit.theta)),
        kkt_gap=fit.kkt_gap,
        gradient=fit.gradient,
        converged=fit.converged,
        orders=tuple(
            Order(
                plays=trial.shape.plays,
                dead_zones=trial.shape.below + trial.shape.above,
                bends=2 * trial.shape.bends,
                lag=trial.shape.lag,
                held_out_rms_m=trial.held_out_rms * stroke_m,
            )
            for trial in choice.trials
        ),
    )
