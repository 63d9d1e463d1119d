"""Screening: what every effect would bring to a view, real trials against unphysical twins."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Trial
from piezoid.diagnosis.folds import Held, Null
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array

REFINEMENTS = 4
STEPS = 3
SURE = 3.3  # standard errors: 0.0005 on one side; a wrong cause is worse than one not named
OVER_TWIN = 1.6  # times the twin's gain


@dataclass(frozen=True, kw_only=True, eq=False)
class Screened:
    """The best of an effect's trials.

    trial  the best real one that physics allows, or the best real one
    held   what it brings
    twin   gain of the best twin
    share  rms of what it adds, of the whole stroke
    bound  the largest such share the data allow, one-sided 95 %
    sound  whether physics allows it
    """

    effect: Effect
    trial: Trial
    held: Held
    twin: float
    share: float
    bound: float
    sound: bool

    @property
    def speaks(self) -> bool:
        """Tell whether this is evidence: sure, worth it, physical, and better than its twins."""
        return (
            self.sound
            and self.held.z > SURE
            and self.held.gain > max(self.effect.worth, OVER_TWIN * self.twin)
            and self.share > self.effect.least
        )


def screen(effect: Effect, view: View) -> Screened | None:
    """Return the best of an effect's trials, None where it has none on these recordings."""
    trials = [t for t in effect.trials(view) if np.any(t.columns)] if effect.trials else []
    null = view.null if effect.against is None else effect.against(view)
    if not any(trial.real for trial in trials):
        return None
    return screened(effect, null, trials)


def screened(effect: Effect, null: Null, trials: Sequence[Trial]) -> Screened:
    """Judge trials against a null."""
    widths = np.cumsum([0, *(t.columns.shape[1] for t in trials)])
    across = null.without(np.hstack([t.columns for t in trials]))
    judged = [
        (t, null.held(across[:, a:b], projected=True), across[:, a:b])
        for t, a, b in zip(trials, widths[:-1], widths[1:], strict=True)
    ]
    twin = max((held.gain for t, held, _ in judged if not t.real), default=0.0)
    real = [(t, held, c) for t, held, c in judged if t.real]
    allowed = [row for row in real if _sound(row[0], row[1])]
    trial, held, columns = max(allowed or real, key=lambda row: row[1].gain)
    share, bound = _shares(held, columns)
    return Screened(
        effect=effect,
        trial=trial,
        held=held,
        twin=twin,
        share=share,
        bound=bound,
        sound=bool(allowed),
    )


def _sound(trial: Trial, held: Held) -> bool:
    low, high = trial.within
    return bool(low <= held.coefficient[0] <= high)


def _shares(held: Held, across: Array) -> tuple[float, float]:
    """Return the rms of what a trial adds beyond the null, of the whole stroke, and its bound."""
    own = float(np.sqrt(np.mean((across @ held.coefficient) ** 2)))
    length = np.sqrt(np.mean(across**2, axis=0))
    doubt = float(np.sqrt(np.sum((length * held.spread) ** 2)))
    return own / 2.0, (own + 1.645 * doubt) / 2.0


def refined(found: Screened, view: View) -> Screened:
    """Improve the free parameters of a trial, one after another, by ever smaller steps."""
    best, columns = found, found.effect.columns
    if columns is None:
        return found
    for halving in range(REFINEMENTS):
        for name, width in found.trial.free.items():
            for sign in (-1.0, 1.0):
                best = _climbed(best, view, name, width, sign / 2**halving)
    return best


def _climbed(best: Screened, view: View, name: str, width: float, part: float) -> Screened:
    """Step on in one direction for as long as it gets better."""
    for _ in range(STEPS):
        again = _stepped(best, view, name, width, part)
        if again is best:
            break
        best = again
    return best


def _stepped(best: Screened, view: View, name: str, width: float, part: float) -> Screened:
    value = best.trial.parameters[name]
    other = value * width**part if width > 1.0 else value + part * width
    parameters = {**best.trial.parameters, name: other}
    assert best.effect.columns is not None
    columns = best.effect.columns(view, parameters)
    if not np.any(columns):
        return best
    trial = replace(best.trial, parameters=parameters, columns=columns)
    again = screened(best.effect, view.null, [trial])
    better = again.held.gain > best.held.gain and again.sound >= best.sound
    return replace(again, twin=best.twin) if better else best
