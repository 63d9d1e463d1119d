"""How many plays and dead zones, and which lag: the smallest model that predicts as well.

Judged on rows the fit did not see: on other recordings where there are several, else on the
second half of the only one. Random splits would prove nothing; neighbouring samples are copies.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.hysteresis.search import (
    Fitted,
    Settings,
    continued,
    search,
    transferred,
)
from piezoid.identification.quality import IN_SAMPLE, OTHER_RECORDINGS, SECOND_HALF
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Samples

ORDERS = ((2, 0), (4, 1), (8, 2), (12, 4), (16, 6))
LAGS = ("delay", "first_order")
BENDS = (3, 6)
CLOSE = 1.03  # a smaller model within 3 % of the best is the better model
CLOSE_IN_SAMPLE = 1.15  # the error of the fit itself falls with every number more
FOLDS = 3
MANY = 12  # crossings of the middle: so many are more than one loop, whatever their noise
ROUNDED = 1e-9  # of a sum of squares: more than its rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One shape and its held-out error.

    shape     what was fitted
    residual  (rows,)  on rows the fits of all folds did not see, scaled units
    lag_s     fitted lag, of the last fold
    """

    shape: Shape
    residual: Array
    lag_s: float

    @property
    def held_out_rms(self) -> float:
        """Return the rms of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @classmethod
    def of(cls, shape: Shape, folds: Sequence[tuple[Array, float]]) -> "Trial":
        """Return the trial whose folds left these residuals and found these lags."""
        residuals = [residual for residual, _ in folds]
        return cls(shape=shape, residual=np.concatenate(residuals), lag_s=folds[-1][1])


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The chosen shape among those tried.

    best    the chosen trial
    trials  all, in the order they were tried
    kind    of what is held out, as ``FitQuality`` has it
    """

    best: Trial
    trials: tuple[Trial, ...]
    kind: str


Elsewhere = Callable[[Shape], Trial | None]
"""What somebody else has tried meanwhile; None: try it here."""


def choose_shape(
    pieces: Sequence[Piece],
    settings: Settings,
    *,
    orders: Sequence[tuple[int, int]] = ORDERS,
    elsewhere: Elsewhere = lambda _: None,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Try orders, then envelopes and lags, and take the smallest that predicts as well.

    elsewhere  gives the trials of ``bent_shapes``, which need nothing of the others; it is asked
               last, when they have had the most time
    """
    trials = [_try(pieces, shape, settings, progress) for shape in _shapes_of(orders)]
    close = CLOSE_IN_SAMPLE if is_untested(pieces) else CLOSE
    best = _smallest_close(trials, close)
    late = [_try(pieces, replace(best.shape, lag=lag), settings, progress) for lag in LAGS[1:]]
    bent = [
        elsewhere(shape) or _try(pieces, shape, settings, progress)
        for shape in bent_shapes(orders)
    ]
    for other in (*bent, *late):
        trials.append(other)
        if other.held_out_rms * close < best.held_out_rms:
            best = other
    kind = OTHER_RECORDINGS if _recordings(pieces) > 1 else SECOND_HALF
    if is_untested(pieces):
        kind = IN_SAMPLE
    return Choice(best=best, trials=tuple(trials), kind=kind)


def _shapes_of(orders: Sequence[tuple[int, int]]) -> tuple[Shape, ...]:
    return tuple(Shape(plays=plays, below=zones, above=zones) for plays, zones in orders)


def bent_shapes(orders: Sequence[tuple[int, int]]) -> tuple[Shape, ...]:
    """Return the shapes with an envelope.

    It has something to bend only where minor loops stand at several biases, and then it needs the
    plays: it is tried at the richest order.
    """
    richest = max(_shapes_of(orders), key=lambda shape: shape.plays)
    return tuple(replace(richest, bends=bends) for bends in BENDS)


def _smallest_close(trials: Sequence[Trial], close: float) -> Trial:
    least = min(trial.held_out_rms for trial in trials)
    return next(trial for trial in trials if trial.held_out_rms <= close * least)


def _try(
    pieces: Sequence[Piece], shape: Shape, settings: Settings, progress: Callable[[str], None]
) -> Trial:
    progress(
        f"{shape.plays} plays, {shape.below + shape.above} dead zones, {2 * shape.bends} bends, "
        f"{shape.lag.replace('_', ' ')}"
    )
    return attempted(pieces, shape, settings)


def attempted(pieces: Sequence[Piece], shape: Shape, settings: Settings) -> Trial:
    """Try a shape on every fold."""
    return Trial.of(shape, list(_folded(pieces, shape, settings)))


def attempt(
    pieces: Sequence[Piece], shape: Shape, settings: Settings, *, within: float
) -> Trial | None:
    """Try a shape as the others were tried; None where its held-out error is above ``within``.

    Whoever is that wrong on some folds stays it whatever the others say: they are left out.
    """
    room = within**2 * sum(_unseen_rows(*fold) for fold in folds_of(pieces)) * (1.0 + ROUNDED)
    found = []
    for residual, lag_s in _folded(pieces, shape, settings):
        found.append((residual, lag_s))
        room -= float(residual @ residual)
        if room < 0.0:
            return None
    trial = Trial.of(shape, found)
    return trial if trial.held_out_rms <= within else None


def _folded(
    pieces: Sequence[Piece], shape: Shape, settings: Settings
) -> Iterator[tuple[Array, float]]:
    """Fit a shape to every fold's training part and look at the part it did not see."""
    for training, testing in folds_of(pieces):
        fitted = search(training, shape, settings)
        yield _unseen(fitted, training, testing), fitted.operator.lag_s


def _recordings(pieces: Sequence[Piece]) -> int:
    return len({piece.recording for piece in pieces})


def folds_of(pieces: Sequence[Piece]) -> Iterator[tuple[tuple[Piece, ...], tuple[Piece, ...]]]:
    """Yield (training, testing): whole recordings in turn, or two halves of a single one."""
    count = _recordings(pieces)
    if is_untested(pieces):
        yield tuple(pieces), tuple(pieces)
        return
    if count == 1:
        training = tuple(replace(p, last=p.first + p.rows // 2) for p in pieces)
        yield training, tuple(pieces)
        return
    folds = min(count, FOLDS)
    for fold in range(folds):
        testing = tuple(p for p in pieces if p.recording % folds == fold)
        training = tuple(p for p in pieces if p.recording % folds != fold)
        if training and testing:
            yield training, testing


def is_untested(pieces: Sequence[Piece]) -> bool:
    """Tell whether one loop is all there is: its second half is a branch the first never saw."""
    if _recordings(pieces) > 1 or sum(map(_crossings, pieces)) > MANY:
        return False
    return scope_of(pieces).is_untested


def _crossings(piece: Piece) -> int:
    drive = piece.drive[piece.first : piece.last]
    return int(np.count_nonzero(np.diff(np.signbit(drive - 0.5 * (drive.max() + drive.min())))))


def _is_continued(training: Sequence[Piece], testing: Sequence[Piece]) -> bool:
    return bool({p.recording for p in testing} & {p.recording for p in training})


def _after(part: Piece, whole: Piece) -> Samples:
    """Return the samples of a piece that count behind the part of it."""
    return replace(whole, first=part.last).counting()


def _unseen_rows(training: Sequence[Piece], testing: Sequence[Piece]) -> int:
    if training == testing:
        return sum(len(piece.counting()) for piece in testing)
    if _is_continued(training, testing):
        pairs = zip(training, testing, strict=True)
        return sum(len(_after(part, whole)) for part, whole in pairs)
    return sum(len(piece.counting()) for piece in testing)


def _unseen(fitted: Fitted, training: Sequence[Piece], testing: Sequence[Piece]) -> Array:
    if training == testing:  # one loop: nothing is unseen
        return np.concatenate(
            [
                (continued(fitted, i, piece) - piece.response)[piece.counting()]
                for i, piece in enumerate(testing)
            ]
        )
    if _is_continued(training, testing):
        return np.concatenate(
            [
                (continued(fitted, i, part) - part.response)[_after(part, whole)]
                for i, (part, whole) in enumerate(zip(training, testing, strict=True))
            ]
        )
    other = transferred(fitted, testing)
    return np.concatenate(
        [
            (continued(other, i, piece) - piece.response)[piece.counting()]
            for i, piece in enumerate(testing)
        ]
    )
