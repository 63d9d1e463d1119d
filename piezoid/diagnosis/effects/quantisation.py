"""Quantisation: the converter's steps are coarse.

What you see
    The reading takes few values, all multiples of one step, and rests on them.
Why it happens
    A converter has too few bits, or its range is far wider than the signal.
How it is detected
    All readings lie on one lattice whose step is a visible part of the stroke.
What the extension adds
    Nothing: the remedy is a finer converter or a narrower range.
Source
    Widrow & Kollar (2008)
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Fault
from piezoid.diagnosis.signals import stroke_of, with_displacement
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.faults import step_size
from piezoid.records.recording import Recording

COARSE = 1.2e-3  # of half the stroke: rms of a twelfth of its square is 0.02 % of the stroke
EXACT = 0.25  # of all steps: how many rows repeat the one before


def _fault(view: View) -> Fault | None:
    steps = [step_size(np.round(track.response, 9)) for track in view.tracks]
    coarse = [
        step
        for step, track in zip(steps, view.tracks, strict=True)
        if step > COARSE and float(np.mean(np.diff(track.response) == 0)) > 0.0
    ]
    if len(coarse) < len(steps):
        return None
    step_m = view.stroke_m * float(np.median(coarse))
    chance = sum(
        _evidence(track.response, step) for track, step in zip(view.tracks, steps, strict=True)
    )
    return Fault(
        tracks=view.tracks,
        value=1e9 * step_m,
        spread=1e7 * step_m,
        p_value=float(np.exp(-min(chance, 700.0))),
    )


def _evidence(response: Array, step: float) -> float:
    """Return n R^2, whose exponential is how rarely n free phases point together as these do.

    R = |mean exp(2 pi i y / step)|, over the rows at which the reading changed  [Rayleigh's test]
    """
    changed = response[1:][np.diff(response) != 0]
    together = abs(np.mean(np.exp(2j * np.pi * changed / step))) if len(changed) else 0.0
    return float(len(changed) * together**2)


def inject(recording: Recording, share: float) -> Recording:
    """Round the reading to steps whose error has this rms."""
    step_m = np.sqrt(12.0) * share * stroke_of(recording)
    return with_displacement(recording, step_m * np.round(recording.displacement_m() / step_m))


EFFECT = Effect(
    name="quantisation",
    explanation=__doc__ or "",
    unit="nm, one step",
    experiment="Record the same sweep with the converter's range reduced to the signal, or with "
    "more bits; a step that shrinks with the range is the converter's.",
    fault=_fault,
    inject=inject,
)
