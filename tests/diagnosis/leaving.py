"""Views of one slow sine that leave what we say, and candidates with chosen numbers on them."""

from dataclasses import replace
from functools import cache

import numpy as np

from piezoid.diagnosis.blocked_regression import CrossValidated
from piezoid.diagnosis.candidate import Candidate
from piezoid.diagnosis.effect import Effect
from piezoid.diagnosis.refitted_view import SelectedEffect
from piezoid.diagnosis.residual_view import View, view_of, with_tracks
from piezoid.diagnosis.segments import BLOCKS, Track

ROWS = 3000
RATE_Hz = 30.0
STROKE_m = 1e-5  # half of it
NOISE = 1e-3  # of half the stroke


@cache
def view_with(structure: float) -> View:
    """Return a view that leaves noise, and a wave this many times as large that nothing follows.

    The wave has thirty-seven periods while the drive has three: no hysteresis is like it.
    """
    turn = 2.0 * np.pi * np.arange(ROWS) / ROWS
    noise = np.random.default_rng(4).normal(size=ROWS)
    left = NOISE * (noise + structure * np.sqrt(2.0) * np.sin(37.0 * turn))
    drive = np.sin(3.0 * turn)
    response = 0.6 * drive + 0.3 * drive**3 + left
    track = Track(
        name="sine",
        rate_Hz=RATE_Hz,
        command=drive,
        drive=drive,
        sensor_Hz=None,
        response=response,
        others={},
        place=np.arange(ROWS),
        block=np.arange(ROWS) * BLOCKS // ROWS,
    )
    return view_of([track], stroke_m=STROKE_m, voltage_V=50.0, rest=-1.0)


@cache
def view_leaving(rms: float, *, structure: float = 0.0) -> View:
    """Return the same view of a response so many times as large that it leaves this error."""
    view = view_with(structure)
    times = rms / view.rms
    return with_tracks(view, [replace(t, response=times * t.response) for t in view.tracks])


def candidate_of(
    effect: Effect,
    cv: CrossValidated,
    *,
    without: View,
    view: View,
    placebo: CrossValidated | None = None,
    share: float = 0.01,
    physical: bool = True,
) -> Candidate:
    """Return an effect that was judged to bring this."""
    return Candidate(
        selected=SelectedEffect(effect=effect, parameters={}),
        cv=cv,
        placebo=placebo,
        share=share,
        physical=physical,
        without=without,
        view=view,
    )
