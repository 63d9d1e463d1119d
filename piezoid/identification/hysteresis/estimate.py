"""One axis from its recordings: the whole way from scaled pieces to an AxisModel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.formatting import with_unit
from piezoid.identification.forward import Forward
from piezoid.identification.hysteresis.applicability import (
    AS_GOOD,
    WIDE,
    reason_in_loops,
    reason_of_error,
    reason_of_lag,
    reason_of_no_answer,
    widest_opening,
)
from piezoid.identification.hysteresis.certificate import certify
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.cycles import Cycles, cycles_of, trends_over_cycles
from piezoid.identification.hysteresis.forgetting import Transient, without_transients
from piezoid.identification.hysteresis.gauss_newton import minimise
from piezoid.identification.hysteresis.jackknife import jackknife
from piezoid.identification.hysteresis.lag_rivals import EXPLAINED, lag_rivals
from piezoid.identification.hysteresis.order import (
    ORDERS,
    Choice,
    choose_shape,
    without_bends,
)
from piezoid.identification.hysteresis.outlying import left_out_of, without_outliers
from piezoid.identification.hysteresis.physical import physical, piece_start
from piezoid.identification.hysteresis.pieces import Piece, Rig, Scales, pieces_of, scales_of
from piezoid.identification.hysteresis.remarks import remarks_on
from piezoid.identification.hysteresis.scope import limits_as_recorded, limits_of_cycles, scope_of
from piezoid.identification.hysteresis.search import (
    Fitted,
    Settings,
    continued,
    search,
    searched_from,
)
from piezoid.identification.hysteresis.sensor_noise import noise_is_most, sensor_noise
from piezoid.identification.hysteresis.simplify import simplified
from piezoid.identification.hysteresis.summary import summarise
from piezoid.identification.model import AxisModel, Lag
from piezoid.identification.piece_start import PieceStart
from piezoid.identification.quality import FitQuality, Limit, Order, Verdict
from piezoid.records.recording import Recording
from piezoid.records.reversals import noise_of, reversals_of

FIRST_SHAPE = Shape(plays=8, below=2, above=2)
CHOOSING_ROWS = 4000
FINAL_ROWS = 40_000
POLISH = 4  # Jacobians over every row once the thinned search is done
Progress = Callable[[str], None]
Orders = Sequence[tuple[int, int]]


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """Pieces ready to be fitted, and what was left out of them."""

    scales: Scales
    pieces: tuple[Piece, ...]
    settings: Settings
    transients: tuple[Transient, ...]
    said: tuple[str, ...]


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
    ordered = by_name(recordings)
    ready = _prepare(ordered, axis, rig, progress)
    choosing, tried, in_loops = _choosing(ready, orders)
    choice = choose_shape(ready.pieces, choosing, orders=tried, progress=progress)
    cycles = [one for one in map(cycles_of, ready.pieces) if one is not None]
    slides = limits_of_cycles(cycles)
    # Where lag or gain change from cycle to cycle, what they leave hides by how much plays do
    # better than one lag.
    goes = bool(slides) or any(one.gain is not None for one in cycles)
    lag = "" if in_loops or goes else reason_of_lag(ready.pieces, choice, choosing, progress)
    limits, only_lag = _limits(ready, choice, progress)
    only_lag = "" if goes else only_lag
    choice = without_bends(choice) if only_lag else choice
    against = (
        reason_of_no_answer(ready.pieces, choice, ready.scales)
        or lag
        or only_lag
        or in_loops
        or reason_of_error(ready.pieces, choice)
    )
    progress("final fit")
    fitted = _final(ready, choice)
    found = _axis_model(ordered, axis, rig, ready, choice, fitted, against, cycles)
    limits = (*limits, *limits_as_recorded(ordered, axis), *slides)
    limits = tuple(sorted(limits, key=lambda limit: limit.most))
    given = [recording.name for recording in recordings]
    starts = tuple(sorted(found.starts, key=lambda start: given.index(start.recording)))
    return replace(found, starts=starts, quality=replace(found.quality, limits=limits))


def by_name(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """Return recordings in the one order in which they are fitted.

    Which are left out together follows from it, and in the last digit every sum over rows.
    """
    return tuple(sorted(recordings, key=lambda recording: recording.name))


def _limits(ready: Prepared, choice: Choice, progress: Progress) -> tuple[tuple[Limit, ...], str]:
    """Return what was never measured, and why no hysteresis was seen where a lag does as well.

    A lag of second order is tried where no speed was varied: only there can it be a loop. Its two
    numbers stand beside hysteresis without an envelope, whose two dozen follow the corners that a
    lag makes at every turn: 0.20 % for 0.57 of a positioner that is all lag, where the lag leaves
    0.54. On thirteen published laws a lag leaves from 1.2 (loops of five sizes, Coleman and
    Hodgdon's) to 24 times what such hysteresis does, and from 0.18 of what no lag leaves.
    """
    scope = scope_of(ready.pieces)
    if not scope.has_one_speed or scope.branches < 2:
        return scope.limits(), ""
    progress("a lag of second order, without hysteresis")
    height = max(float(np.ptp(p.response[p.first : p.last])) for p in ready.pieces)
    plain, late, none = lag_rivals(ready.pieces, ready.settings.longest_lag_s)
    best, plays = min(plain.held_out_rms, late.held_out_rms), choice.best.held_out_rms
    straight = without_bends(choice).best.held_out_rms
    envelope = ", an envelope" if choice.best.shape.bends else ""
    left = (
        f"of the range, plays{envelope} and a lag leave {100 * plays / height:.2g} %, a lag of "
        f"second order without hysteresis {100 * plain.held_out_rms / height:.2g} % (at "
        f"{with_unit(plain.frequency_Hz, 'Hz')}, damping {plain.damping:.2g}), with a delay "
        f"besides {100 * late.held_out_rms / height:.2g} %"
    )
    wide = widest_opening(ready.pieces) > WIDE * height
    explains = plain.rises and best < EXPLAINED * none.held_out_rms
    is_lag = wide and explains and best <= AS_GOOD * straight
    bent = (
        f"; plays without an envelope {100 * straight / height:.2g} %" if straight > plays else ""
    )
    only = f"the loop is phase lag, not hysteresis: {left}{bent}" if is_lag else ""
    return scope.limits(f" ({left})"), only


def _choosing(ready: Prepared, orders: Orders) -> tuple[Settings, Orders, str]:
    """Return how shapes are tried, which orders, and what in the loops is against the class.

    Where the loops rule it out, one small fit is enough to show how wrong it is.
    """
    against = reason_in_loops(ready.pieces)
    settings = replace(ready.settings, rows=CHOOSING_ROWS, iterations=12)
    return settings, orders[:1] if against else orders, against


def _prepare(recordings: Sequence[Recording], axis: str, rig: Rig, progress: Progress) -> Prepared:
    progress("first fit")
    scales = scales_of(recordings, axis)
    pieces = pieces_of(recordings, axis, scales, rig)
    settings = Settings(
        longest_lag_s=longest_lag_s(pieces), sensor_pole_Hz=rig.sensor_bandwidth_Hz
    )
    quick = replace(settings, rows=CHOOSING_ROWS, iterations=12)
    rough = search(pieces, FIRST_SHAPE, quick)
    clean = without_outliers(rough)
    said = left_out_of(pieces, clean)
    if said:
        rough = search(clean, FIRST_SHAPE, quick)
    pieces, transients = without_transients(rough)
    settings = replace(settings, lag_s=rough.operator.lag_s)
    return Prepared(
        scales=scales, pieces=pieces, settings=settings, transients=transients, said=said
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


def _final(ready: Prepared, choice: Choice) -> Fitted:
    """Search over all rows; from the folds' operators as well where that ends above the error they
    left on rows unseen: there is a better place then.
    """
    settings, best = replace(ready.settings, rows=FINAL_ROWS), choice.best
    fitted = search(ready.pieces, best.shape, settings)
    if fitted.minimum.rms > best.held_out_rms:
        begun = (
            searched_from(ready.pieces, operator, best.shape.lag, settings)
            for operator in best.fitted
        )
        better = min((fitted, *begun), key=lambda found: found.minimum.rms)
        fitted = replace(better, kkt_gap=fitted.kkt_gap)
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
    ready: Prepared,
    choice: Choice,
    fitted: Fitted,
    against: str,
    cycles: Sequence[Cycles],
) -> AxisModel:
    scales, theta = ready.scales, fitted.minimum.theta
    stroke_m = abs(scales.displacement_m)
    found = jackknife(theta, fitted.task)
    starts = starts_of(fitted, scales)
    zero_m = float(np.mean([start.zero_m.mean() for start in starts]))
    drives = [recording.voltage_V(axis) for recording in recordings]
    slew = max(
        float(np.abs(np.diff(u)).max()) * r.sampling_rate_Hz
        for u, r in zip(drives, recordings, strict=True)
    )
    quality = _quality(fitted, choice, ready.pieces, stroke_m)
    trends = [
        said
        for one in cycles
        for said in trends_over_cycles(one, stroke_m, quality.noise_rms_m / stroke_m)
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
            applies=not against,
            reason=against,
            remarks=(
                *ready.said,
                *trends,
                *remarks_on(fitted, ready.transients, choice),
            ),
        ),
        quality=quality,
        uncertainty=summarise(found, fitted.task.coordinates, scales),
        certificate=certify(
            found,
            fitted.task.coordinates,
            scales,
            choice.best.residual * stroke_m,
            slew,
            fitted.task.longest_lag_s,
        ),
    )


def starts_of(fitted: Fitted, scales: Scales) -> tuple[PieceStart, ...]:
    """Return where every piece began: its memory and its zero."""
    coordinates, theta = fitted.task.coordinates, fitted.minimum.theta
    forward = Forward(operator=fitted.operator)
    return tuple(
        piece_start(
            piece,
            forward.memory(piece.drive[0], theta[coordinates.memory_slice(index)]),
            theta[coordinates.offset_slice(index)],
            fitted.operator,
            scales,
        )
        for index, piece in enumerate(fitted.task.pieces)
    )


def _pooled(noise: Sequence[float], rows: Sequence[int]) -> float:
    return float(np.sqrt(np.average(np.square(noise), weights=rows)))


def _quality(
    fitted: Fitted, choice: Choice, pieces: Sequence[Piece], stroke_m: float
) -> FitQuality:
    minimum = fitted.minimum
    height = max(float(np.ptp(piece.response[piece.first : piece.last])) for piece in pieces)
    left = [continued(fitted, index, piece) - piece.response for index, piece in enumerate(pieces)]
    noise = list(map(sensor_noise, pieces, left))
    return FitQuality(
        rms_m=minimum.rms * stroke_m,
        held_out_rms_m=choice.best.held_out_rms * stroke_m,
        held_out_kind=choice.kind,
        range_m=height * stroke_m,
        noise_rms_m=stroke_m * _pooled(noise, [piece.rows for piece in pieces]),
        noise_is_most=any(map(noise_is_most, pieces, left)),
        rows=sum(piece.rows for piece in pieces),
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
