"""Order selection: the smallest number of plays and dead zones that predicts as well.

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
from piezoid.numerics.arrays import Array, Samples

ORDERS = ((2, 0), (4, 1), (8, 2), (12, 4), (16, 6))
LAGS = ("delay", "first_order")
BENDS = (3, 6)
CLOSE = 1.03  # times the rms of the best: not noticeable
CLOSE_IN_SAMPLE = 1.15  # the error of the fit itself falls with every number more
NO_BETTER = 2  # consecutive orders without improvement, after which the search stops
FOLDS = 3
MANY = 12  # crossings of the middle: so many are more than one loop, whatever their noise
BEYOND = 0.1  # of half the drive range: allowed extrapolation of a model
ROUNDED = 1e-9  # of a sum of squares: more than its rounding


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """Training and held-out pieces of one fold.

    training  pieces, or first halves of pieces
    testing   pieces
    trained   how many of the pieces tested were trained on in part: both begin with them
    """

    training: tuple[Piece, ...]
    testing: tuple[Piece, ...]
    trained: int

    def unseen_samples(self, number: int) -> Samples:
        """Return the samples of a tested piece that count and were not trained on."""
        piece = self.testing[number]
        if number >= self.trained or self.training == self.testing:
            return piece.counting()  # a single loop has no unseen part: all of it is used
        return replace(piece, first=self.training[number].last).counting()


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
    """Try orders, then envelopes and lags, and take the smallest that predicts as well.

    An envelope has something to bend only where minor loops stand at several biases, and then it
    needs the plays: it is tried at the richest order, then at smaller ones.
    """
    in_sample = is_untested(pieces)

    def fit(shape: Shape) -> Trial:
        progress(
            f"{shape.plays} plays, {shape.below + shape.above} dead zones, {2 * shape.bends} "
            f"bends, {shape.lag.replace('_', ' ')}"
        )
        trial = attempt(pieces, shape, settings, within=np.inf)
        assert trial is not None  # no error is above infinity
        return trial

    shapes = [Shape(plays=plays, below=zones, above=zones) for plays, zones in orders]
    trials = _fit_growing(shapes, fit, in_sample)
    straight = _smallest_as_good(trials, in_sample)
    lagged = [fit(replace(straight.shape, lag=lag)) for lag in LAGS[1:]]
    best_lagged = min(lagged, key=lambda trial: trial.held_out_rms)
    if not _is_as_good(straight, best_lagged, in_sample):  # with the wrong lag no size helps
        shapes = [replace(shape, lag=best_lagged.shape.lag) for shape in shapes]
        larger = [shape for shape in shapes if shape.plays > straight.shape.plays]
        trials += _fit_growing(larger, fit, in_sample)
        straight = _smallest_as_good((*trials, best_lagged), in_sample)
    richest = max(shapes, key=lambda shape: shape.plays)
    trials += [fit(replace(richest, bends=bends)) for bends in BENDS]
    best = _smallest_as_good(trials, in_sample)
    if best.shape.bends:
        for shape in shapes:
            if straight.shape.plays <= shape.plays < best.shape.plays:
                trials.append(fit(replace(shape, bends=best.shape.bends)))
                if _is_as_good(trials[-1], best, in_sample):
                    break
    trials += lagged
    best = _smallest_as_good(trials, in_sample)
    kind = OTHER_RECORDINGS if all(f.trained == 0 for f in folds_of(pieces)) else WIDEST_HALVED
    if in_sample:
        kind = IN_SAMPLE
    elif _recordings(pieces) == 1:
        kind = SECOND_HALF
    return Choice(best=best, trials=tuple(trials), kind=kind)


def without_bends(choice: Choice) -> Choice:
    """Return the choice among the shapes without an envelope."""
    straight = [trial for trial in choice.trials if not trial.shape.bends]
    best = _smallest_as_good(straight, choice.kind == IN_SAMPLE)
    return replace(choice, best=best)


def _fit_growing(
    shapes: Sequence[Shape], fit: Callable[[Shape], Trial], in_sample: bool
) -> list[Trial]:
    """Try shapes of growing size until ``NO_BETTER`` of them in a row improve nothing."""
    trials: list[Trial] = []
    for shape in shapes:
        trials.append(fit(shape))
        latest = trials[-NO_BETTER:]
        if any(
            all(_is_as_good(trial, larger, in_sample) for larger in latest)
            for trial in trials[:-NO_BETTER]
        ):
            break
    return trials


def _smallest_as_good(trials: Sequence[Trial], in_sample: bool) -> Trial:
    best = min(trials, key=lambda trial: trial.held_out_rms)
    ordered = sorted(trials, key=lambda trial: trial.shape.numbers)
    return next(trial for trial in ordered if _is_as_good(trial, best, in_sample))


def _is_as_good(smaller: Trial, best: Trial, in_sample: bool) -> bool:
    """Tell whether the smaller of two may stand for the better."""
    close = CLOSE_IN_SAMPLE if in_sample else CLOSE
    return smaller.held_out_rms <= close * best.held_out_rms


def attempt(
    pieces: Sequence[Piece], shape: Shape, settings: Settings, *, within: float
) -> Trial | None:
    """Try a shape as the others were tried; None where its held-out error is above ``within``.

    A shape that is that wrong on some folds stays so whatever the others show: they are skipped.
    """
    folds = list(folds_of(pieces))
    rows = sum(len(fold.unseen_samples(k)) for fold in folds for k in range(len(fold.testing)))
    room = within**2 * rows * (1.0 + ROUNDED)
    residuals, operators = [], []
    for fold in folds:
        fitted = search(fold.training, shape, settings)
        residual = _unseen(fitted, fold)
        residuals.append(residual)
        operators.append(fitted.operator)
        room -= float(residual @ residual)
        if room < 0.0:
            return None
    trial = Trial(shape=shape, residual=np.concatenate(residuals), fitted=tuple(operators))
    return None if trial.held_out_rms > within else trial


def _recordings(pieces: Sequence[Piece]) -> int:
    return len({piece.recording for piece in pieces})


def folds_of(pieces: Sequence[Piece]) -> Iterator[Fold]:
    """Yield folds that test whole recordings in turn, or the second half of a single one.

    A recording that goes further than all the others tells what they cannot know: its first half
    stays in the training, as of each of two, for one alone tells too little of a shape that both
    together can tell. Such parts stand first, at the same places as what they are parts of.
    """
    count = _recordings(pieces)
    if is_untested(pieces):
        yield Fold(training=tuple(pieces), testing=tuple(pieces), trained=len(pieces))
        return
    folds = min(count, FOLDS)
    for fold in range(folds):
        held_out = [p for p in pieces if p.recording % folds == fold]
        remaining = tuple(p for p in pieces if p.recording % folds != fold)
        wide = tuple(p for p in held_out if count == 2 or not _is_covered(p, remaining))
        parts = tuple(replace(p, last=p.first + p.rows // 2) for p in wide)
        if held_out and (remaining or parts):
            yield Fold(
                training=(*parts, *remaining),
                testing=(*wide, *(p for p in held_out if p not in wide)),
                trained=len(parts),
            )


def _is_covered(piece: Piece, remaining: Sequence[Piece]) -> bool:
    """Tell whether other pieces go as far as this one, in one swing and to either side."""
    if not remaining:
        return False
    drives = [p.fitted_drive for p in (piece, *remaining)]
    (low, high), *ranges = [(float(drive.min()), float(drive.max())) for drive in drives]
    return (
        min(a for a, _ in ranges) <= low + BEYOND
        and max(b for _, b in ranges) >= high - BEYOND
        and max(b - a for a, b in ranges) >= high - low - BEYOND
    )


def is_untested(pieces: Sequence[Piece]) -> bool:
    """Tell whether one loop is all there is: its second half is a branch the first never saw."""
    if _recordings(pieces) > 1:
        return False
    crossings = 0
    for piece in pieces:
        drive = piece.fitted_drive
        is_low = np.signbit(drive - 0.5 * (drive.max() + drive.min()))
        crossings += int(np.count_nonzero(np.diff(is_low)))
    return crossings <= MANY and scope_of(pieces).is_untested


def _unseen(fitted: Fitted, fold: Fold) -> Array:
    """Return the residual of a fit where it was not trained.

    Zero and memory of other recordings are fitted, and the zero of the half of one that is among
    others; that of the only recording stays where its first half left it.
    """
    fresh = fold.testing[fold.trained :]
    refitted = transferred(fitted, fresh) if fresh else fitted
    is_only_recording = _recordings((*fold.training, *fold.testing)) == 1
    residuals = []
    for number, piece in enumerate(fold.testing):
        if number < fold.trained:  # keep the zero of the training part
            output = continued(fitted, number, fold.training[number])
        else:
            output = continued(refitted, number - fold.trained, piece)
        error = (output - piece.response)[fold.unseen_samples(number)]
        is_offset_free = number < fold.trained and not is_only_recording
        residuals.append(error - error.mean() if is_offset_free else error)
    return np.concatenate(residuals)
