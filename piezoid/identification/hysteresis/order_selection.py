"""Order selection: the smallest number of plays and dead zones that predicts as well.

"As well" means within 3 % of the best held-out error. Adding a standard error of the paired
difference doubles the error on fresh drives for laws that plays follow badly (Dahl, Duhem).
The held-out rows are other recordings if there are several, else the second half of the only
recording; a recording with the largest range is halved as well. Random splits prove nothing,
because neighbouring samples are almost equal.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.identification.forward import Scaled
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.hysteresis.scope import scope_of
from piezoid.identification.hysteresis.search import (
    Settings,
    refit_initial_state,
    search,
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
CLOSE_IN_SAMPLE = 1.15  # the error in sample falls with every further parameter
NO_BETTER = 2  # consecutive orders without improvement, after which the search stops
FOLDS = 3
MAX_CROSSINGS = 12  # of the middle of the drive, in a recording of a single loop with its noise
MAX_EXTRAPOLATION = 0.1  # of half the drive range


@dataclass(frozen=True, kw_only=True, eq=False)
class Fold:
    """Training and held-out pieces of one fold.

    training  pieces, or first halves of pieces
    testing   pieces
    halved    number of pieces in both: both begin with them, ``training`` has their first halves
    """

    training: tuple[Piece, ...]
    testing: tuple[Piece, ...]
    halved: int

    def held_out_samples(self, number: int) -> Samples:
        """Return the samples of a tested piece that were not trained on."""
        piece = self.testing[number]
        if number >= self.halved or self.training == self.testing:
            return piece.fitted_samples()  # a single loop is both training and testing data
        return replace(piece, first=self.training[number].last).fitted_samples()


@dataclass(frozen=True, kw_only=True, eq=False)
class Trial:
    """One shape and its held-out error.

    shape      that was fitted
    residual   (rows,)  on the held-out rows of all folds, scaled units
    operators  of the folds, scaled units
    """

    shape: Shape
    residual: Array
    operators: tuple[Scaled, ...]

    @property
    def held_out_rms(self) -> float:
        """Rms of the residual."""
        return float(np.sqrt(np.mean(self.residual**2)))


@dataclass(frozen=True, kw_only=True, eq=False)
class Choice:
    """The chosen shape among those tried.

    best    the chosen trial
    trials  all, in the order they were tried
    kind    of the held-out data, as in ``FitQuality``
    """

    best: Trial
    trials: tuple[Trial, ...]
    kind: str


def choose_shape(
    pieces: Sequence[Piece],
    settings: Settings,
    *,
    orders: Sequence[tuple[int, int]],
    progress: Callable[[str], None],
) -> Choice:
    """Fit orders, then envelopes and lags, and choose the smallest that predicts as well.

    An envelope helps only with minor loops at several biases, and then together with many plays:
    it is tried with the largest order, then with smaller ones.
    """
    in_sample = is_untested(pieces)

    def fit(shape: Shape) -> Trial:
        progress(
            f"{shape.plays} plays (width of loops), {shape.below + shape.above} dead zones "
            f"(curve of the displacement), {2 * shape.bends} bends (curve of the drive), lag: "
            f"{shape.lag.replace('_', ' ')}"
        )
        return fit_trial(pieces, shape, settings)

    shapes = [Shape(plays=plays, below=zones, above=zones) for plays, zones in orders]
    trials = _fit_growing(shapes, fit, in_sample)
    straight = _smallest_as_good(trials, in_sample)
    lagged = [fit(replace(straight.shape, lag=lag)) for lag in LAGS[1:]]
    best_lagged = min(lagged, key=lambda trial: trial.held_out_rms)
    if not _is_as_good(straight, best_lagged, in_sample):  # no order helps with the wrong lag
        shapes = [replace(shape, lag=best_lagged.shape.lag) for shape in shapes]
        larger = [shape for shape in shapes if shape.plays > straight.shape.plays]
        trials += _fit_growing(larger, fit, in_sample)
        straight = _smallest_as_good((*trials, best_lagged), in_sample)
    largest = max(shapes, key=lambda shape: shape.plays)
    trials += [fit(replace(largest, bends=bends)) for bends in BENDS]
    best = _smallest_as_good(trials, in_sample)
    if best.shape.bends:
        for shape in shapes:
            if straight.shape.plays <= shape.plays < best.shape.plays:
                trials.append(fit(replace(shape, bends=best.shape.bends)))
                if _is_as_good(trials[-1], best, in_sample):
                    break
    trials += lagged
    best = _smallest_as_good(trials, in_sample)
    kind = OTHER_RECORDINGS if all(f.halved == 0 for f in folds_of(pieces)) else WIDEST_HALVED
    if in_sample:
        kind = IN_SAMPLE
    elif _count_recordings(pieces) == 1:
        kind = SECOND_HALF
    return Choice(best=best, trials=tuple(trials), kind=kind)


def without_bends(choice: Choice) -> Choice:
    """Return the choice among the trials without an envelope."""
    straight = [trial for trial in choice.trials if not trial.shape.bends]
    best = _smallest_as_good(straight, choice.kind == IN_SAMPLE)
    return replace(choice, best=best)


def _fit_growing(
    shapes: Sequence[Shape], fit: Callable[[Shape], Trial], in_sample: bool
) -> list[Trial]:
    """Fit shapes of growing size until ``NO_BETTER`` of them in a row improve nothing."""
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
    ordered = sorted(trials, key=lambda trial: trial.shape.parameters)
    return next(trial for trial in ordered if _is_as_good(trial, best, in_sample))


def _is_as_good(smaller: Trial, best: Trial, in_sample: bool) -> bool:
    """Return whether the error of the smaller shape is close to that of the best."""
    close = CLOSE_IN_SAMPLE if in_sample else CLOSE
    return smaller.held_out_rms <= close * best.held_out_rms


def fit_trial(pieces: Sequence[Piece], shape: Shape, settings: Settings) -> Trial:
    """Fit a shape to every fold.

    Zero and memory of whole held-out recordings are fitted. The second half of a recording keeps
    the memory of the first; its zero is fitted unless it is the only recording.
    """
    residuals, operators = [], []
    for fold in folds_of(pieces):
        fit = search(fold.training, shape, settings)
        operators.append(fit.operator)
        whole_pieces = fold.testing[fold.halved :]
        refitted = refit_initial_state(fit, whole_pieces) if whole_pieces else fit
        is_only_recording = _count_recordings((*fold.training, *fold.testing)) == 1
        errors = []
        for number, piece in enumerate(fold.testing):
            if number < fold.halved:  # keep the zero of the training half
                output = fit.simulate(number, fold.training[number])
            else:
                output = refitted.simulate(number - fold.halved, piece)
            error = (output - piece.response)[fold.held_out_samples(number)]
            is_offset_free = number < fold.halved and not is_only_recording
            errors.append(error - error.mean() if is_offset_free else error)
        residuals.append(np.concatenate(errors))
    return Trial(shape=shape, residual=np.concatenate(residuals), operators=tuple(operators))


def _count_recordings(pieces: Sequence[Piece]) -> int:
    return len({piece.recording for piece in pieces})


def folds_of(pieces: Sequence[Piece]) -> Iterator[Fold]:
    """Yield folds that test whole recordings in turn, or the second half of a single recording.

    A recording with a larger range than all others is split in half, so that no fold extrapolates;
    so is each of two recordings, because one alone determines too little of a shape. The halves
    come first in ``training``, in the order of their pieces in ``testing``.
    """
    count = _count_recordings(pieces)
    if is_untested(pieces):
        yield Fold(training=tuple(pieces), testing=tuple(pieces), halved=len(pieces))
        return
    folds = min(count, FOLDS)
    for fold in range(folds):
        held_out = [p for p in pieces if p.recording % folds == fold]
        remaining = tuple(p for p in pieces if p.recording % folds != fold)
        ranges = [(float(p.fitted_drive.min()), float(p.fitted_drive.max())) for p in remaining]
        wide: list[Piece] = []  # pieces whose range or swing the remaining pieces do not cover
        for piece in held_out:
            low, high = float(piece.fitted_drive.min()), float(piece.fitted_drive.max())
            is_covered = (
                bool(ranges)
                and min(a for a, _ in ranges) <= low + MAX_EXTRAPOLATION
                and max(b for _, b in ranges) >= high - MAX_EXTRAPOLATION
                and max(b - a for a, b in ranges) >= high - low - MAX_EXTRAPOLATION
            )
            if count == 2 or not is_covered:
                wide.append(piece)
        halves = tuple(replace(p, last=p.first + p.rows // 2) for p in wide)
        if held_out and (remaining or halves):
            yield Fold(
                training=(*halves, *remaining),
                testing=(*wide, *(p for p in held_out if p not in wide)),
                halved=len(halves),
            )


def is_untested(pieces: Sequence[Piece]) -> bool:
    """Return whether there is one loop only, so that no part of it can be held out.

    The second half of a loop is a branch that the first half does not contain.
    """
    if _count_recordings(pieces) > 1:
        return False
    crossings = 0
    for piece in pieces:
        drive = piece.fitted_drive
        is_low = np.signbit(drive - 0.5 * (drive.max() + drive.min()))
        crossings += int(np.count_nonzero(np.diff(is_low)))
    return crossings <= MAX_CROSSINGS and scope_of(pieces).is_untested
