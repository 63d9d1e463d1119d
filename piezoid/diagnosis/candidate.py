"""A candidate: an effect with everything refitted around it, against the same without it."""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from piezoid.diagnosis.blocked_regression import CrossValidated, compared, paired_z
from piezoid.diagnosis.bouc_wen_search import with_bouc_wen_of
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.refinement import stepped
from piezoid.diagnosis.refitted_view import SelectedEffect, offset_of, undisturbed_for
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.score_test import ScoreTest, null_of, score_test, screened

MINIMUM_Z = 3.3  # standard errors, 0.0005 on one side: a wrong cause is worse than one not named
MINIMUM_SHARE = 5e-5  # of the stroke: what is smaller is not promised to show
NUDGE = 0.1  # of a parameter's width
TELLING = 0.15  # of the longest column: what a track's column must keep beside the null
APART = 0.35  # of the fitted time
SURE = 4.0  # standard errors
OVER_PLACEBO = 1.6  # times the placebo's gain, or
BEYOND_PLACEBO = 0.9  # times what the placebo leaves above the noise, rms, and
SURER = 2.5  # standard errors less in the blocks
AS_LITTLE = 1.005  # times the error: what leaves no more does the same
DOUBTFUL = 0.03  # of the noise, in power: what it may be wrong by
# Size over structural residual that a name needs. On 200 stages of thirteen laws wrong names (but
# initial states) lie at 0.43 to 1.5, half of them below it; the smallest right ones are a creep of
# the bundled stage, 0.88, and one at half size, 0.91 (docs/measured/zoo.md).
STRUCTURAL = 0.8


@dataclass(frozen=True, kw_only=True, eq=False)
class Candidate:
    """An effect beside others.

    selected  the effect with its parameters
    cv        what it brings
    placebo   what its best placebo brings, None where there is none
    share     rms of what it adds beyond the null, of the whole stroke
    physical  whether physics allows it
    without   the view with the others at work
    view      the view with it at work as well
    """

    selected: SelectedEffect
    cv: CrossValidated
    placebo: CrossValidated | None
    share: float
    physical: bool
    without: View
    view: View

    @property
    def effect(self) -> Effect:
        """Return the effect."""
        return self.selected.effect

    @property
    def has_a_name(self) -> bool:
        """Tell whether it is significant and not small beside the structure that is left."""
        return self.is_significant and exceeds_structure(
            self.share, self.view.rms, self.view.noise
        )

    @property
    def strength(self) -> float:
        """Return how many times larger it is than the structure that is left beside it.

            2 share / sqrt(max(rms^2 - noise^2, DOUBTFUL noise^2))

        Its null distribution is that of healthy stages of other laws (``null_distribution``).
        """
        noise = self.view.noise
        structure = sqrt(max(self.view.rms**2 - noise**2, DOUBTFUL * noise**2))
        return 2.0 * self.share / max(structure, 1e-300)

    @property
    def is_significant(self) -> bool:
        """Tell whether this is sure, worth it, physical, and better than its placebos."""
        return (
            self.physical
            and self.cv.z > MINIMUM_Z
            and self.cv.gain > self.effect.minimum_gain
            and self._beats_placebo
        )

    @property
    def _beats_placebo(self) -> bool:
        """Return whether it brings clearly more than its placebo, or leaves clearly less.

        What takes most of an error leaves its placebo no room to bring a 1.6th of it: a gain that
        changed between two recordings takes 0.51 of an error of which its placebo takes 0.49.
        """
        if self.placebo is None or self.cv.gain > OVER_PLACEBO * self.placebo.gain:
            return True
        own, others = (max(h.rms**2 - self.view.noise**2, 0.0) for h in (self.cv, self.placebo))
        surer = paired_z(self.placebo.loss, self.cv.loss) > SURER
        return surer and own < BEYOND_PLACEBO**2 * others


def exceeds_structure(share: float, rms: float, noise: float) -> bool:
    """Tell whether an effect is not small beside the structure that the nuisance class leaves.

        2 share > STRUCTURAL sqrt(max(rms^2 - noise^2, 0))

    share  rms of what the effect adds, of the whole stroke
    rms    of the residual with everything at work, of half the stroke
    noise  of the sensor, of half the stroke

    What a misspecified class leaves has some shape, and one of the catalogue comes nearest to it.
    """
    return 2.0 * share > STRUCTURAL * sqrt(max(rms**2 - noise**2, 0.0))


def part_explained(gain: float, left: float, noise: float) -> float:
    """Return which part of what is no noise was taken off, in power.

    gain  part of the error that was taken off
    left  the error after that
    """
    before = (left / (1.0 - gain)) ** 2
    return (before - left**2) / max(before - noise**2, DOUBTFUL * noise**2)


def judged(one: SelectedEffect, view: View, without: View, *, seen: ScoreTest) -> Candidate:
    """Judge an effect beside others.

    view     with it and all others at work
    without  with the others
    seen     its screening there, for its placebos and for what physics allows
    """
    if one.adds_columns:
        return _of_columns(one, seen, without, view)
    return Candidate(
        selected=one,
        cv=compared(without.null, view.null),
        placebo=seen.placebo,
        share=sqrt(max(without.rms**2 - view.rms**2, 0.0)) / 2.0,
        physical=one.within_limits
        and (one.effect.response_filter is None or is_consistent(one, view)),
        without=without,
        view=view,
    )


def _of_columns(one: SelectedEffect, seen: ScoreTest, without: View, view: View) -> Candidate:
    assert one.effect.columns is not None
    columns = one.effect.columns(undisturbed_for(view, [one]), one.parameters)
    if not np.any(columns):  # refitted with it, the stage itself does what it would have added
        return Candidate(
            selected=one,
            cv=seen.cv,
            placebo=seen.placebo,
            share=0.0,
            physical=False,
            without=without,
            view=view,
        )
    trial = replace(seen.trial, columns=columns, parameters=one.parameters)
    null = null_of(one.effect, without)
    found = screened(one.effect, null, [trial], one_speed=view.one_speed)
    return Candidate(
        selected=one,
        cv=found.cv,
        placebo=seen.placebo,
        share=found.share,
        physical=found.physical and one.within_limits,
        without=without,
        view=view,
    )


def structural_candidate(effect: Effect, final: View) -> tuple[ScoreTest, Candidate] | None:
    """Judge a part of the nuisance class itself, with all causes at work; None without trials.

    The class without it may have a Bouc-Wen state instead. Where that leaves as little, the part
    has to speak beside the state that serves that class best.
    """
    found = score_test(effect, final)
    if found is None:
        return None
    structure = _structure_of(found, final)
    own = effect.structural
    if own is None or not (structure.is_significant and own.may_be_bouc_wen):
        return found, structure
    bent = with_bouc_wen_of(final, own.null_without)
    again = score_test(effect, bent)
    if again is None or own.null_without(bent).rms >= AS_LITTLE * final.rms:
        return found, structure
    return again, _structure_of(again, bent)


def _structure_of(found: ScoreTest, final: View) -> Candidate:
    selected = SelectedEffect(effect=found.effect, parameters=found.trial.parameters)
    return Candidate(
        selected=selected,
        cv=found.cv,
        placebo=found.placebo,
        share=found.share,
        physical=found.physical,
        without=final,
        view=final,
    )


def is_consistent(one: SelectedEffect, view: View) -> bool:
    """Tell whether no track asks for a clearly different time than the fitted one.

    A filter of the chain is the same in every recording that can show it. At the fitted time each
    track may have a time of its own,

        y = h(t - tau) + sum_k d_k dh/dtau [track k],

    and a d_k that surely differs from none by a good part of tau belongs to that recording alone.
    """
    name = next(iter(one.free))
    there = stepped(one, name, NUDGE)
    ratio = there.parameters[name] / one.parameters[name] - 1.0
    change = offset_of(view, [there]) - offset_of(view, [one])
    edges = view.nuisance.edges
    columns = np.column_stack(
        [
            view.of_track(k, change[edges[k] : edges[k + 1]] / ratio)
            for k in range(len(view.tracks))
        ]
    )
    length = np.linalg.norm(view.null.without(columns), axis=0)
    columns = columns[:, length > TELLING * length.max()]
    across = view.null.without(columns)
    apart = np.linalg.lstsq(across, view.null.residual, rcond=1e-9)[0]
    error = np.sqrt(np.diag(view.null.clustered_covariance(columns)))
    return not bool(np.any((np.abs(apart) > APART) & (np.abs(apart) > SURE * error)))
