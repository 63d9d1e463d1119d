"""Judgement: an effect with everything refitted around it, against the same without it."""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocks import surely
from piezoid.diagnosis.consistency import is_alike
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.extended import Accepted, calm_for
from piezoid.diagnosis.folds import Held, compared
from piezoid.diagnosis.knee import with_knee_of
from piezoid.diagnosis.screening import Screened, null_of, screen, screened
from piezoid.diagnosis.view import View

CERTAIN = 8.0  # standard errors: so sure a thing, or one where little is left but noise,
SMALL = 0.5  # may be that part of the gain which is asked for
OVER_TWIN = 1.6  # times the twin's gain, or
BEYOND_TWIN = 0.9  # times what the twin leaves, or leaves above the noise, and that
AS_LITTLE = 1.005  # times the error: what leaves no more does the same
STRANGE = 1.25  # times the noise: what a class leaves of a material that it does not follow
STILL = 2.5  # standard errors of what is there beside it
MUCH = 0.4  # of what is no noise, in power: so much may be structure however little it is
DOUBTFUL = 0.03  # of the noise, in power: what it may be wrong by
FAR_SURER, SURER = 1.5, 2.5  # standard errors less in the blocks, for the one and the other


@dataclass(frozen=True, kw_only=True, eq=False)
class Judged:
    """An effect beside others.

    accepted  the effect with its parameters
    held      what it brings
    twin      what its best unphysical twin brings, None where there is none
    share     rms of what it adds beyond the null, of the whole stroke
    sound     whether physics allows it
    without   the view with the others at work
    view      the view with it at work as well
    """

    accepted: Accepted
    held: Held
    twin: Held | None
    share: float
    sound: bool
    without: View
    view: View

    @property
    def effect(self) -> Effect:
        """Return the effect."""
        return self.accepted.effect

    @property
    def speaks(self) -> bool:
        """Tell whether this is evidence, and enough of it to be named."""
        return self.is_evidence and self.share > self.effect.least

    @property
    def is_evidence(self) -> bool:
        """Tell whether this is sure, worth it, physical, and better than its twins."""
        return (
            self.sound
            and self.held.z > self.effect.sure
            and (self.held.gain > self.effect.worth * self._asked or self.settles_it)
            and self._beats_its_twin
        )

    @property
    def settles_it(self) -> bool:
        """Tell whether structure that not every ceramic has takes off much of what is left."""
        if self.effect.against is None or self.effect.common:
            return False
        return part_explained(self.held.gain, self.held.rms, self.view.noise) > MUCH

    @property
    def _asked(self) -> float:
        """Return which part of the worth is asked for."""
        if self.effect.common:
            return 1.0
        return SMALL if self.held.z > CERTAIN else asked(self.without)

    @property
    def _beats_its_twin(self) -> bool:
        if self.twin is None or self.held.gain > OVER_TWIN * self.twin.gain:
            return True
        clear = surely(self.twin.loss, self.held.loss)
        if self.held.rms < BEYOND_TWIN * self.twin.rms:
            return clear > FAR_SURER
        own, others = (max(h.rms**2 - self.view.noise**2, 0.0) for h in (self.held, self.twin))
        return own < BEYOND_TWIN**2 * others and clear > SURER


def part_explained(gain: float, left: float, noise: float) -> float:
    """Return which part of what is no noise was taken off, in power.

    gain  part of the error that was taken off
    left  the error after that
    """
    before = (left / (1.0 - gain)) ** 2
    return (before - left**2) / max(before - noise**2, DOUBTFUL * noise**2)


def asked(without: View) -> float:
    """Return which part of a worth is asked for where little is left but noise."""
    excess = max(1.0 - (without.noise / without.rms) ** 2, 0.0)
    return max(SMALL, sqrt(excess))


def judged(one: Accepted, view: View, without: View, *, seen: Screened) -> Judged:
    """Judge an effect beside others.

    view     with it and all others at work
    without  with the others
    seen     its screening there, for its twins and for what physics allows
    """
    if one.adds:
        return _of_columns(one, seen, without, view)
    return Judged(
        accepted=one,
        held=compared(without.null, view.null),
        twin=seen.twin,
        share=sqrt(max(without.rms**2 - view.rms**2, 0.0)) / 2.0,
        sound=one.inside and (one.effect.passes is None or is_alike(one, view)),
        without=without,
        view=view,
    )


def _of_columns(one: Accepted, seen: Screened, without: View, view: View) -> Judged:
    assert one.effect.columns is not None
    columns = one.effect.columns(calm_for(view, [one]), one.parameters)
    if not np.any(columns):  # refitted with it, the stage itself does what it would have added
        return Judged(
            accepted=one,
            held=seen.held,
            twin=seen.twin,
            share=0.0,
            sound=False,
            without=without,
            view=view,
        )
    trial = replace(seen.trial, columns=columns, parameters=one.parameters)
    found = screened(one.effect, null_of(one.effect, without), [trial])
    return Judged(
        accepted=one,
        held=found.held,
        twin=seen.twin,
        share=found.share,
        sound=found.sound and one.inside,
        without=without,
        view=view,
    )


def judged_structure(effect: Effect, final: View) -> tuple[Screened, Judged] | None:
    """Judge a part of the envelope's own structure, with all causes at work; None without trials.

    The class without it may have a Bouc-Wen state instead. Where that leaves as little, the part
    has to speak beside the state that serves that class best; where little is at stake, in a
    material that no class here follows, it has to be there beside it still.
    """
    found = screen(effect, final)
    if found is None:
        return None
    structure = _of_structure(found, final)
    if not (structure.speaks and effect.knee and effect.against):
        return found, structure
    bent = with_knee_of(final, effect.against)
    as_well = effect.against(bent).rms < AS_LITTLE * final.rms
    again = screen(effect, bent)
    small = structure.held.gain < effect.knee and final.rms > STRANGE * final.noise
    if again is None or not (as_well or small):
        return found, structure
    if not as_well and again.sound and again.held.z > STILL:
        return found, structure
    return again, _of_structure(again, bent)


def _of_structure(found: Screened, final: View) -> Judged:
    accepted = Accepted(effect=found.effect, parameters=found.trial.parameters)
    return Judged(
        accepted=accepted,
        held=found.held,
        twin=found.twin,
        share=found.share,
        sound=found.sound,
        without=final,
        view=final,
    )
