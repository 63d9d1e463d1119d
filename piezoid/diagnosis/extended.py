"""Extended: tracks with the effects that were accepted, refitted with all of them in place."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.view import View, with_drives
from piezoid.numerics.arrays import Array

ROUNDS = 2  # of static response and what effects make of it


@dataclass(frozen=True, kw_only=True, eq=False)
class Accepted:
    """An effect with the trial that spoke for it."""

    effect: Effect
    trial: Trial

    @property
    def acts(self) -> bool:
        """Whether it changes drive or response; the envelope has the other ones already."""
        return self.effect.columns is not None

    @property
    def parameters(self) -> Parameters:
        """Return the nonlinear parameters."""
        return self.trial.parameters


def extended(clean: View, accepted: Sequence[Accepted]) -> View:
    """Return the view in which these effects are at work.

    What acts on the drive changes the drive, for good; what acts on the response gives columns,
    made of a static response that itself is fitted beside them.
    """
    drives = []
    for track in clean.tracks:
        drive = track.drive
        for one in accepted:
            if one.effect.drive is not None:
                drive = one.effect.drive(drive, track.rate_Hz, one.parameters)
        drives.append(drive)
    view = with_drives(clean, drives)
    for _ in range(ROUNDS):
        view = replace(view, accepted=columns_of(view, accepted))
    return view


def columns_of(view: View, accepted: Sequence[Accepted]) -> Array:
    """Return the columns of all accepted effects that act on the response."""
    parts = [
        one.effect.columns(view, one.parameters)
        for one in accepted
        if one.effect.drive is None and one.effect.columns is not None
    ]
    return np.hstack([np.zeros((len(view.response), 0)), *parts])
