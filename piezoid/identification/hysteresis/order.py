"""How many plays and dead zones, and which lag: the smallest model that predicts as well.

As well is within 3 % of the best. A standard error of the paired difference on top of that was
tried and is not taken: on laws that plays follow badly (Dahl, Duhem) it doubled the error on fresh
drives.
Judged on rows the fit did not see: on other recordings where there are several, else on the
second half of the only one, as of one that goes further than all others. Random splits would prove
nothing; neighbouring samples are copies.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.hysteresis.coordinates import Scaled, Shape
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.hysteresis.search import (
    Fitted,
    Settings,
    continued,
    search,
    transferred,
)
from piezoid.identification.quality import (
    IN_SAMPLE,
    OTHER_RECORDINGS,
    SECOND_HALF,
    WIDEST_HALVED,
)
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Samples

ORDERS = ((2, 0), (4, 1), (8, 2), (12, 4), (16, 6))
LAGS = ("delay", "first_order")
BENDS = (3, 6)
CLOSE = 1.03  # times the rms of the best: nobody would notice
CLOSE_IN_SAMPLE = 1.15  # the error of the fit itself falls with every number more
NO_BETTER = 2  # orders in a row that bring nothing: the next would not either
FOLDS = 3
MANY = 12  # crossings of the middle: so many are more than one loop, whatever their noise
BEYOND = 0.1  # of half the drive's range: what a model may be asked beyond what it was shown
ROUNDED = 1e-9  # of a sum of squares: more than its rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One shape and its held-out error.

    shape     what was fitted
    residual  (rows,)  on rows the fits of all folds did not see, scaled units
    fitted    the operator of each fold, scaled units
    """

    shape: Shape
    residual: Array
    fitted: tuple[Scaled, ...]

    @property
    def held_out_rms(self) -> float:
        """Return the rms of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))

    @property
    def lag_s(self) -> float:
        """Return the fitted lag of the last fold."""
        return self.fitted[-1].lag_s

    @classmethod
    def of(cls, shape: Shape, folds: Sequence[tuple[Array, Scaled]]) -> "Trial":
        """Return the trial whose folds left these residuals and found these operators."""
        residuals = [residual for residual, _ in folds]
        fitted = tuple(operator for _, operator in folds)
        return cls(shape=shape, residual=np.concatenate(residuals), fitted=fitted)


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


def choose_shape(
    pieces: Sequence[Piece],
    settings: Settings,
    *,
    orders: Sequence[tuple[int, int]] = ORDERS,
    progress: Callable[[str], None] = lambda _: None,
) -> Choice:
    """Try orders, then envelopes and lags, and take the smallest that predicts as well."""
    untested = is_untested(pieces)

    def tried(shape: Shape) -> Trial:
        return _try(pieces, shape, settings, progress)

    shapes = _shapes_of(orders)
    trials = _ladder(shapes, tried, untested)
    straight = _smallest_as_good(trials, untested)
    late = [tried(replace(straight.shape, lag=lag)) for lag in LAGS[1:]]
    bent = _bent_shapes(orders)
    least = min(late, key=lambda trial: trial.held_out_rms)
    if not _is_as_good(straight, least, untested):  # beside the wrong lag no size helps
        lag = least.shape.lag
        shapes = tuple(replace(shape, lag=lag) for shape in shapes)
        bent = tuple(replace(shape, lag=lag) for shape in bent)
        larger = [shape for shape in shapes if shape.plays > straight.shape.plays]
        trials += _ladder(larger, tried, untested)
        straight = _smallest_as_good((*trials, least), untested)
    trials += [tried(shape) for shape in bent]
    best = _smallest_as_good(trials, untested)
    if best.shape.bends:
        begun = straight.shape.plays
        fewer = (s for s in shapes if begun <= s.plays < best.shape.plays)
        trials += _until_as_good(
            best, (replace(s, bends=best.shape.bends) for s in fewer), tried, untested
        )
    trials += late
    best = _smallest_as_good(trials, untested)
    return Choice(best=best, trials=tuple(trials), kind=_kind_of(pieces))


def without_bends(choice: Choice) -> Choice:
    """Return the choice among the shapes without an envelope."""
    straight = [trial for trial in choice.trials if not trial.shape.bends]
    best = _smallest_as_good(straight, choice.kind == IN_SAMPLE)
    return replace(choice, best=best)


def _kind_of(pieces: Sequence[Piece]) -> str:
    """Return what is held out, in the words of ``FitQuality``."""
    if is_untested(pieces):
        return IN_SAMPLE
    if _recordings(pieces) == 1:
        return SECOND_HALF
    whole = all(
        {p.recording for p in training}.isdisjoint(p.recording for p in testing)
        for training, testing in folds_of(pieces)
    )
    return OTHER_RECORDINGS if whole else WIDEST_HALVED


def _shapes_of(orders: Sequence[tuple[int, int]]) -> tuple[Shape, ...]:
    return tuple(Shape(plays=plays, below=zones, above=zones) for plays, zones in orders)


def _bent_shapes(orders: Sequence[tuple[int, int]]) -> tuple[Shape, ...]:
    """Return the shapes with an envelope.

    It has something to bend only where minor loops stand at several biases, and then it needs the
    plays: it is tried at the richest order.
    """
    richest = max(_shapes_of(orders), key=lambda shape: shape.plays)
    return tuple(replace(richest, bends=bends) for bends in BENDS)


def _ladder(
    shapes: Sequence[Shape], tried: Callable[[Shape], Trial], untested: bool
) -> list[Trial]:
    """Try shapes of growing size for as long as that brings anything."""
    trials: list[Trial] = []
    for shape in shapes:
        trials.append(tried(shape))
        last = trials[-NO_BETTER:]
        earlier = trials[:-NO_BETTER]
        if any(all(_is_as_good(one, other, untested) for other in last) for one in earlier):
            break
    return trials


def _until_as_good(
    best: Trial, shapes: Iterator[Shape], tried: Callable[[Shape], Trial], untested: bool
) -> list[Trial]:
    """Try shapes of growing size until one is as good as the best."""
    trials: list[Trial] = []
    for shape in shapes:
        trials.append(tried(shape))
        if _is_as_good(trials[-1], best, untested):
            break
    return trials


def _smallest_as_good(trials: Sequence[Trial], untested: bool) -> Trial:
    best = min(trials, key=lambda trial: trial.held_out_rms)
    ordered = sorted(trials, key=lambda trial: trial.shape.numbers)
    return next(trial for trial in ordered if _is_as_good(trial, best, untested))


def _is_as_good(smaller: Trial, best: Trial, untested: bool) -> bool:
    """Tell whether the smaller of two may stand for the better."""
    close = CLOSE_IN_SAMPLE if untested else CLOSE
    return smaller.held_out_rms <= close * best.held_out_rms


def _try(
    pieces: Sequence[Piece], shape: Shape, settings: Settings, progress: Callable[[str], None]
) -> Trial:
    progress(
        f"{shape.plays} plays, {shape.below + shape.above} dead zones, {2 * shape.bends} bends, "
        f"{shape.lag.replace('_', ' ')}"
    )
    return Trial.of(shape, list(_folded(pieces, shape, settings)))


def attempt(
    pieces: Sequence[Piece], shape: Shape, settings: Settings, *, within: float
) -> Trial | None:
    """Try a shape as the others were tried; None where its held-out error is above ``within``.

    Whoever is that wrong on some folds stays it whatever the others say: they are left out.
    """
    room = within**2 * sum(_unseen_rows(*fold) for fold in folds_of(pieces)) * (1.0 + ROUNDED)
    found = []
    for residual, operator in _folded(pieces, shape, settings):
        found.append((residual, operator))
        room -= float(residual @ residual)
        if room < 0.0:
            return None
    trial = Trial.of(shape, found)
    return trial if trial.held_out_rms <= within else None


def _folded(
    pieces: Sequence[Piece], shape: Shape, settings: Settings
) -> Iterator[tuple[Array, Scaled]]:
    """Fit a shape to every fold's training part and look at the part it did not see."""
    for training, testing in folds_of(pieces):
        fitted = search(training, shape, settings)
        yield _unseen(fitted, training, testing), fitted.operator


def _recordings(pieces: Sequence[Piece]) -> int:
    return len({piece.recording for piece in pieces})


def folds_of(pieces: Sequence[Piece]) -> Iterator[tuple[tuple[Piece, ...], tuple[Piece, ...]]]:
    """Yield (training, testing): whole recordings in turn, or two halves of a single one.

    A recording that goes further than all the others tells what they cannot know: its first half
    stays in the training, as of each of two, for one alone tells too little of a shape that both
    together can tell. Such parts stand first, at the same places as what they are parts of.
    """
    count = _recordings(pieces)
    if is_untested(pieces):
        yield tuple(pieces), tuple(pieces)
        return
    folds = min(count, FOLDS)
    for fold in range(folds):
        left = [p for p in pieces if p.recording % folds == fold]
        others = tuple(p for p in pieces if p.recording % folds != fold)
        wide = tuple(p for p in left if count == 2 or not _is_covered(p, others))
        parts = tuple(replace(p, last=p.first + p.rows // 2) for p in wide)
        if left and (others or parts):
            yield (*parts, *others), (*wide, *(p for p in left if p not in wide))


def _is_covered(piece: Piece, others: Sequence[Piece]) -> bool:
    """Tell whether the others go as far as a piece, in one swing and to either side."""
    if not others:
        return False
    ends = [_ends(other) for other in others]
    low, high = _ends(piece)
    return (
        min(a for a, _ in ends) <= low + BEYOND
        and max(b for _, b in ends) >= high - BEYOND
        and max(b - a for a, b in ends) >= high - low - BEYOND
    )


def _ends(piece: Piece) -> tuple[float, float]:
    drive = piece.drive[piece.first : piece.last]
    return float(drive.min()), float(drive.max())


def is_untested(pieces: Sequence[Piece]) -> bool:
    """Tell whether one loop is all there is: its second half is a branch the first never saw."""
    if _recordings(pieces) > 1 or sum(map(_crossings, pieces)) > MANY:
        return False
    return scope_of(pieces).is_untested


def _crossings(piece: Piece) -> int:
    drive = piece.drive[piece.first : piece.last]
    return int(np.count_nonzero(np.diff(np.signbit(drive - 0.5 * (drive.max() + drive.min())))))


def _part_of(number: int, piece: Piece, training: Sequence[Piece]) -> Piece | None:
    """Return what of a piece that is tested was trained on, if anything was."""
    is_part = any(part.recording == piece.recording for part in training)
    return training[number] if is_part else None


def _unseen_samples(
    number: int, piece: Piece, training: Sequence[Piece], testing: Sequence[Piece]
) -> Samples:
    """Return those samples of a piece that count and were not trained on."""
    part = _part_of(number, piece, training)
    if part is None or training == testing:  # one loop: nothing is unseen
        return piece.counting()
    return replace(piece, first=part.last).counting()


def _unseen_rows(training: Sequence[Piece], testing: Sequence[Piece]) -> int:
    return sum(
        len(_unseen_samples(number, piece, training, testing))
        for number, piece in enumerate(testing)
    )


def _unseen(fitted: Fitted, training: Sequence[Piece], testing: Sequence[Piece]) -> Array:
    """Return what a fit leaves where it was not trained.

    Zero and memory of other recordings are fitted, and the zero of the half of one that is among
    others; that of the only recording stays where its first half left it.
    """
    parts = [_part_of(number, piece, training) for number, piece in enumerate(testing)]
    fresh = [piece for piece, part in zip(testing, parts, strict=True) if part is None]
    other = transferred(fitted, fresh) if fresh else fitted
    left, seen, alone = [], len(testing) - len(fresh), _recordings((*training, *testing)) == 1
    for number, (piece, part) in enumerate(zip(testing, parts, strict=True)):
        if part is None:
            output = continued(other, number - seen, piece)
        else:  # its zero stays where the part left it
            output = continued(fitted, number, part)
        error = (output - piece.response)[_unseen_samples(number, piece, training, testing)]
        left.append(error - error.mean() if part is not None and not alone else error)
    return np.concatenate(left)
