"""Estimate one axis from its recordings, from scaled pieces to an AxisModel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.hysteresis.applicability import (
    limits_of_lag,
    reason_in_loops,
    reason_of_error,
    reason_of_lag,
    reason_of_no_answer,
)
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.cycles import (
    Cycles,
    cycles_of,
    limits_of_cycles,
    trends_over_cycles,
)
from piezoid.identification.hysteresis.excluded_rows import without_outliers, without_transients
from piezoid.identification.hysteresis.gauss_newton import minimise
from piezoid.identification.hysteresis.order import (
    ORDERS,
    Choice,
    choose_shape,
    without_bends,
)
from piezoid.identification.hysteresis.physical import physical, piece_start
from piezoid.identification.hysteresis.pieces import (
    Piece,
    Rig,
    Scales,
    pieces_of,
    response_range,
    scales_of,
)
from piezoid.identification.hysteresis.scope import limits_as_recorded
from piezoid.identification.hysteresis.search import (
    Fitted,
    Settings,
    continued,
    search,
    searched_from,
    simplified,
)
from piezoid.identification.hysteresis.sensor_noise import noise_is_most, sensor_noise
from piezoid.identification.hysteresis.uncertainty import certify, jackknife, summarise
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.quality import (
    IN_SAMPLE,
    SECOND_HALF,
    FitQuality,
    Order,
    Verdict,
)
from piezoid.operators.play import forgetting_sample
from piezoid.records.recording import Recording
from piezoid.records.reversals import noise_of, reversals_of

FIRST_SHAPE = Shape(plays=8, below=2, above=2)
CHOOSING_ROWS = 4000
FINAL_ROWS = 40_000
LOOSE_KKT = 1e-6  # optimality of the quadratic program that the search starts from
POLISH = 4  # Jacobians over every row once the thinned search is done
Progress = Callable[[str], None]
Orders = Sequence[tuple[int, int]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Pieces ready to be fitted, and remarks on the outliers and transients excluded from them."""

    scales: Scales
    pieces: tuple[Piece, ...]
    settings: Settings
    outliers: tuple[str, ...]
    transients: tuple[str, ...]


def estimate_axis(
    recordings: Sequence[Recording],
    axis: str,
    rig: Rig,
    *,
    orders: Orders = ORDERS,
    progress: Progress = lambda _: None,
) -> AxisModel:
    """Fit one axis: convex start, Gauss-Newton, order by held-out error, uncertainty, verdict.

    recordings  of this axis, each with its own memory and zero; their order changes nothing but
                that of ``starts``
    axis        name
    rig         poles the laboratory declares
    orders      (plays, dead zones per side) to choose from
    progress    told what is being done, for whoever waits

    Raises ``ExcitationError`` where drive or displacement does not move.
    """
    # Which recordings are left out together follows from their order, and in the last digit every
    # sum over rows.
    ordered = tuple(sorted(recordings, key=lambda recording: recording.name))
    data = _prepare(ordered, axis, rig, progress)
    in_loops = reason_in_loops(data.pieces)
    if in_loops:  # one small fit is enough to show how wrong the class is
        orders = orders[:1]
    settings = replace(data.settings, rows=CHOOSING_ROWS, iterations=12)
    choice = choose_shape(data.pieces, settings, orders=orders, progress=progress)
    cycles = [trends for trends in map(cycles_of, data.pieces) if trends is not None]
    slides = limits_of_cycles(cycles)
    # Where lag or gain change from cycle to cycle, their residual hides by how much plays do
    # better than one lag.
    has_trend = bool(slides) or any(trends.gain is not None for trends in cycles)
    lag = ""
    if not in_loops and not has_trend:
        lag = reason_of_lag(data.pieces, choice, settings, progress)
    longest_s = data.settings.longest_lag_s
    limits, second_order_lag = limits_of_lag(data.pieces, choice, longest_s, progress)
    if has_trend:
        second_order_lag = ""
    if second_order_lag:
        choice = without_bends(choice)
    rejection = (
        reason_of_no_answer(data.pieces, choice, data.scales)
        or lag
        or second_order_lag
        or in_loops
        or reason_of_error(data.pieces, choice)
    )
    progress("final fit")
    fitted = _final(data, choice)
    model = _axis_model(ordered, axis, rig, data, choice, fitted, rejection, cycles)
    limits = (*limits, *limits_as_recorded(ordered, axis), *slides)
    limits = tuple(sorted(limits, key=lambda limit: limit.most))
    names = [recording.name for recording in recordings]
    starts = tuple(sorted(model.starts, key=lambda start: names.index(start.recording)))
    return replace(model, starts=starts, quality=replace(model.quality, limits=limits))


def _prepare(recordings: Sequence[Recording], axis: str, rig: Rig, progress: Progress) -> Prepared:
    progress("first fit")
    scales = scales_of(recordings, axis)
    pieces = pieces_of(recordings, axis, scales, rig)
    settings = Settings(
        longest_lag_s=longest_lag_s(pieces), sensor_pole_Hz=rig.sensor_bandwidth_Hz
    )
    quick = replace(settings, rows=CHOOSING_ROWS, iterations=12)
    rough = search(pieces, FIRST_SHAPE, quick)
    pieces, outliers = without_outliers(rough)
    if outliers:
        rough = search(pieces, FIRST_SHAPE, quick)
    pieces, transients = without_transients(rough)
    return Prepared(
        scales=scales,
        pieces=pieces,
        settings=replace(settings, lag_s=rough.operator.lag_s),
        outliers=outliers,
        transients=transients,
    )


def longest_lag_s(pieces: Sequence[Piece]) -> float:
    """Return the longest lag worth searching: a quarter of the slower branches of the drive."""
    branches = []
    for piece in pieces:
        turns = reversals_of(piece.drive, max(noise_of(piece.drive), 0.02))
        edges = np.array([piece.first, *turns, piece.last])
        branches.extend((np.diff(edges) / piece.sampling_rate_Hz).tolist())
    least_s = 10.0 / min(piece.sampling_rate_Hz for piece in pieces)
    return max(least_s, 0.25 * float(np.quantile(branches, 0.9)))


def _final(data: Prepared, choice: Choice) -> Fitted:
    """Search over all rows.

    Where that ends above the error that the folds' operators left on rows unseen, a better
    minimum exists: the search is repeated from these operators.
    """
    settings, best = replace(data.settings, rows=FINAL_ROWS), choice.best
    fitted = search(data.pieces, best.shape, settings)
    if fitted.minimum.rms > best.held_out_rms:
        repeated = (
            searched_from(data.pieces, operator, best.shape.lag, settings)
            for operator in best.fitted
        )
        closest = min((fitted, *repeated), key=lambda fit: fit.minimum.rms)
        fitted = replace(closest, kkt_gap=fitted.kkt_gap)
    fitted = simplified(fitted, iterations=settings.iterations)
    if fitted.task.stride == 1:
        return fitted
    polished = minimise(fitted.minimum.theta, replace(fitted.task, stride=1), iterations=POLISH)
    total = polished.iterations + fitted.minimum.iterations
    return replace(fitted, minimum=replace(polished, iterations=total))


def _axis_model(
    recordings: Sequence[Recording],
    axis: str,
    rig: Rig,
    data: Prepared,
    choice: Choice,
    fitted: Fitted,
    rejection: str,
    cycles: Sequence[Cycles],
) -> AxisModel:
    scales, theta = data.scales, fitted.minimum.theta
    stroke_m = abs(scales.displacement_m)
    jack = jackknife(theta, fitted.task)
    starts = tuple(
        piece_start(piece, index, theta, fitted.task.coordinates, scales, float(piece.drive[0]))
        for index, piece in enumerate(fitted.task.pieces)
    )
    zero_m = float(np.mean([start.zero_m.mean() for start in starts]))
    drives = [recording.voltage_V(axis) for recording in recordings]
    slew = max(
        float(np.abs(np.diff(u)).max()) * r.sampling_rate_Hz
        for u, r in zip(drives, recordings, strict=True)
    )
    quality = _quality(fitted, choice, data.pieces, stroke_m)
    trends = [
        remark
        for of_piece in cycles
        for remark in trends_over_cycles(of_piece, stroke_m, quality.noise_rms_m / stroke_m)
    ]
    return AxisModel(
        axis=axis,
        hysteresis=physical(fitted.operator, scales, zero_m),
        polarity=int(np.sign(scales.displacement_m)),
        lag=Lag(kind=fitted.shape.lag, time_s=fitted.operator.lag_s),
        rig=rig,
        starts=starts,
        voltage_V=(min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)),
        verdict=Verdict(
            applies=not rejection,
            reason=rejection,
            remarks=(
                *data.outliers,
                *trends,
                *data.transients,
                *remarks_on(fitted, choice.kind, rig),
            ),
        ),
        quality=quality,
        uncertainty=summarise(jack, fitted.task.coordinates, scales),
        certificate=certify(
            jack,
            fitted.task.coordinates,
            scales,
            choice.best.residual * stroke_m,
            slew,
            fitted.task.longest_lag_s,
        ),
    )


def remarks_on(fitted: Fitted, held_out_kind: str, rig: Rig) -> tuple[str, ...]:
    """Return remarks on excitation, on weights and lags at their bounds, and on the start."""
    remarks = []
    if held_out_kind == SECOND_HALF:
        remarks.append(
            "The order was chosen by the error on the second half of the only recording that "
            "determines the hysteresis."
        )
    if held_out_kind == IN_SAMPLE:
        remarks.append(
            "The error is in sample: a single loop leaves nothing to test the model on."
        )
    operator, plays = fitted.operator, fitted.shape.plays
    for piece in fitted.task.pieces:
        drive = piece.fitted_drive
        unexcited = int((forgetting_sample(drive, operator.threshold) >= len(drive)).sum())
        if unexcited:
            remarks.append(
                f"{piece.name} does not excite the largest of the {plays} play thresholds "
                f"({unexcited} of them)."
            )
    on_zero = int((operator.weight[1:] <= 0.0).sum())
    if on_zero:
        remarks.append(f"{on_zero} of {plays} play weights lie on 0; only upper limits are given.")
    if fitted.shape.lag != "none" and operator.lag_s <= 0.0:
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
    if fitted.shape.lag != "none" and operator.lag_s >= 0.999 * fitted.task.longest_lag_s > 0.0:
        bound = with_unit(operator.lag_s, "s")
        remarks.append(f"The fitted lag lies on its upper bound, {bound}.")
    if fitted.kkt_gap > LOOSE_KKT:
        remarks.append(f"The convex start is optimal only to {fitted.kkt_gap:.1e}.")
    return tuple(remarks)


def _quality(
    fitted: Fitted, choice: Choice, pieces: Sequence[Piece], stroke_m: float
) -> FitQuality:
    minimum = fitted.minimum
    residuals = [
        continued(fitted, index, piece) - piece.response for index, piece in enumerate(pieces)
    ]
    noise = np.array(list(map(sensor_noise, pieces, residuals)))
    rows = [piece.rows for piece in pieces]
    return FitQuality(
        rms_m=minimum.rms * stroke_m,
        held_out_rms_m=choice.best.held_out_rms * stroke_m,
        held_out_kind=choice.kind,
        range_m=response_range(pieces) * stroke_m,
        noise_rms_m=stroke_m * float(np.sqrt(np.average(np.square(noise), weights=rows))),
        noise_is_most=any(map(noise_is_most, pieces, residuals)),
        rows=sum(rows),
        effective_parameters=float(len(minimum.theta)),
        kkt_gap=fitted.kkt_gap,
        gradient=minimum.gradient,
        converged=minimum.converged,
        orders=tuple(
            Order(
                plays=t.shape.plays,
                dead_zones=t.shape.below + t.shape.above,
                bends=2 * t.shape.bends,
                lag=t.shape.lag,
                held_out_rms_m=t.held_out_rms * stroke_m,
            )
            for t in choice.trials
        ),
    )
