"""The simulation's own error before and after: the model that ships, on rows left out.

The modified Prandtl-Ishlinskii model is fitted to the drives and responses as the accepted effects
leave them; then its tangents and the effects' columns are refitted together, fold by fold.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.diagnosis.extended import Accepted, extended
from piezoid.diagnosis.folds import Null
from piezoid.diagnosis.search import Outcome
from piezoid.diagnosis.view import View
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.rows import Rows, rows_of
from piezoid.identification.hysteresis.search import Fitted, Settings, search
from piezoid.numerics.arrays import Array

SHAPE = Shape(plays=10, below=3, above=3, lag="none")
ROWS = 3000
ITERATIONS = 9
LONGEST_LAG_s = 1.0  # the shape has none


@dataclass(frozen=True, kw_only=True)
class Simulated:
    """Errors on rows left out, in scaled units.

    baseline  of the raw recordings
    final     with everything found
    without   with everything found but one, by its name
    """

    baseline: float
    final: float
    without: dict[str, float]


def simulated(outcome: Outcome) -> Simulated:
    """Return the simulation's errors before, after, and without each thing that was found."""
    accepted = [cause.accepted for cause in outcome.causes if cause.accepted.acts]
    baseline = _error(outcome.first, ())
    if not accepted and not outcome.faults:
        return Simulated(baseline=baseline, final=baseline, without=_structural(outcome, baseline))
    tangents = _tangents(outcome.final)
    final = _held_out(tangents, outcome.final, accepted)
    without = _structural(outcome, final)
    for one in accepted:
        rest = [other for other in accepted if other is not one]
        name = one.effect.name
        if one.effect.drive is None:
            without[name] = _held_out(tangents, outcome.final, rest)
        else:
            without[name] = _error(extended(outcome.clean, rest), rest)
    if outcome.faults:
        raw = _error(extended(outcome.first, accepted), accepted)
        without |= dict.fromkeys(outcome.faults, raw)
    return Simulated(baseline=baseline, final=final, without=without)


def _structural(outcome: Outcome, final: float) -> dict[str, float]:
    """Return the errors without what the envelope has and a model without it has not."""
    found = [cause.found for cause in outcome.causes if not cause.accepted.acts]
    return {f.effect.name: final / (1.0 - min(max(f.held.gain, 0.0), 0.99)) for f in found}


def _error(view: View, accepted: Sequence[Accepted]) -> float:
    return _held_out(_tangents(view), view, accepted)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Linear:
    """A fitted simulation at the rows of a view: its tangents, and the response beside it."""

    tangent: Array
    response: Array


def _tangents(view: View) -> _Linear:
    pieces = _pieces(view)
    settings = Settings(
        longest_lag_s=LONGEST_LAG_s, rows=ROWS, follow_zero=False, iterations=ITERATIONS
    )
    fitted = search(pieces, SHAPE, settings)
    coordinates, edges = fitted.task.coordinates, view.envelope.edges
    tangent = np.zeros((edges[-1], coordinates.total), order="F")
    simulated_rows = np.zeros(edges[-1])
    for index, (piece, track) in enumerate(zip(pieces, view.tracks, strict=True)):
        local = coordinates.local_slice(index)
        columns = np.r_[0 : coordinates.shared, local]
        for rows in _rows(fitted, index, piece):
            which = np.flatnonzero(
                (track.place >= rows.sample[0]) & (track.place <= rows.sample[-1])
            )
            inside = track.place[which] - rows.sample[0]
            target = edges[index] + which
            tangent[np.ix_(target, columns)] = rows.tangent[inside]
            measured = piece.response[track.place[which]]
            simulated_rows[target] = rows.residual[inside] + measured
    return _Linear(tangent=tangent, response=view.response - simulated_rows)


def _rows(fitted: Fitted, index: int, piece: Piece) -> Iterator[Rows]:
    return rows_of(fitted.minimum.theta, fitted.task.coordinates, index, piece, sensor_pole=None)


def _pieces(view: View) -> tuple[Piece, ...]:
    """Return the tracks as pieces, without what the accepted effects add to the response."""
    share = view.null.fit(view.response)[view.envelope.columns.shape[1] :]
    added = view.accepted @ share
    edges = view.envelope.edges
    pieces = []
    for k, track in enumerate(view.tracks):
        rows = added[edges[k] : edges[k + 1]]
        between = np.interp(np.arange(len(track.drive)), track.place, rows)
        response = track.response - between
        pieces.append(
            Piece(
                name=track.name,
                recording=k,
                sampling_rate_Hz=track.rate_Hz,
                drive=track.drive,
                response=response,
                centre_m=0.0,
                first=0,
                last=len(track.drive),
            )
        )
    return tuple(pieces)


def _held_out(linear: _Linear, view: View, accepted: Sequence[Accepted]) -> float:
    """Return the rms of tangents and effects, refitted fold by fold, on rows left out."""
    parts = [
        one.effect.columns(view, one.parameters)
        for one in accepted
        if one.effect.drive is None and one.effect.columns is not None
    ]
    columns = np.hstack([linear.tangent, *parts])
    moving = np.abs(columns).max(axis=0) > 0.0
    null = Null(columns=columns[:, moving], response=linear.response, block=view.block)
    return null.held_out_rms
