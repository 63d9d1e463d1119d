"""Scope of recordings: what they can identify, before any fit.

A branch that was never driven, a speed or an amplitude at which nothing was recorded: no residual
tells of them. Each such lack is a sentence and the most that a score may be with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.quality import Limit
from piezoid.records.recording import Recording
from piezoid.records.reversals import noise_of, reversals_of

LARGE = 0.2  # of the drive's range: a branch that shows a loop
ONE_LOOP = 3  # branches: from the middle up, down and back
SMALL = 0.02  # of the same: less is no reversal
ALIKE = 1.5  # how far the spans of two branches may differ to be compared at two speeds
FASTER = 2.0  # loop width by a lag doubles with the speed, which exceeds any uncertainty
OTHER_SIZE = 1.25  # times the span of the smallest: reversals of more than one size
# the most a score may be: none of them is "good" (90), and what leaves open whether there is a
# loop, or what it is, is no more than "usable with care" (50)
MOST = {"branch": 20, "loop": 40, "speed": 50, "amplitude": 70, "recording": 85}
# the same for what reading found odd about drive and displacement together: a clean recording of
# the stage may look otherwise
AS_RECORDED = {
    "closed_loop": 40,
    "leads": 50,
    "smoothed": 50,
    "implausible_gain": 70,
    "stands": 70,
    "zero_jump": 85,
}


@dataclass(frozen=True, kw_only=True)
class Branch:
    """One monotone run of the drive, in scaled units.

    recording     its number
    span          signed
    speed_per_s   without sign
    is_whole      from one reversal to the next; the first and the last of a piece are not
    """

    recording: int
    span: float
    speed_per_s: float
    is_whole: bool


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Properties of the recordings that decide what a fit can know.

    branches    that are large
    recordings  how many
    speeds      ratio of the fastest to the slowest of like branches of one direction
    amplitudes  ratio of the largest span to the smallest between two reversals
    """

    branches: int
    recordings: int
    speeds: float
    amplitudes: float

    @property
    def is_untested(self) -> bool:
        """Whether no part can be left out that the rest has seen the like of."""
        return self.recordings == 1 and self.branches <= ONE_LOOP

    @property
    def has_one_speed(self) -> bool:
        """Whether loop width and lag cannot be separated."""
        return self.speeds < FASTER

    def limits(self, lag: str = "") -> tuple[Limit, ...]:
        """Return what was not measured, most important first.

        lag  in parentheses: the residual of lags without hysteresis beside that of the fit
        """
        lacks = []
        if self.branches < 2:
            lacks.append(
                (
                    "branch",
                    "only one branch was recorded: hysteresis is the difference of two, and none "
                    "was measured; the error is that of the fit",
                )
            )
        elif self.is_untested:
            lacks.append(
                (
                    "loop",
                    "only one loop was recorded: no part of it can be left out to test the model "
                    "on, and the error is that of the fit",
                )
            )
        if self.branches > 1 and self.has_one_speed:
            lacks.append(
                (
                    "speed",
                    "branches of one size and direction were all driven at one speed: the width "
                    "of the loop cannot be separated from a lag, and the model is untested at "
                    f"other speeds{lag}",
                )
            )
        if self.amplitudes < OTHER_SIZE:
            lacks.append(
                ("amplitude", "every branch has one amplitude: no smaller loop was ever measured")
            )
        if self.recordings == 1:
            lacks.append(
                (
                    "recording",
                    "only one recording determines the hysteresis: the model was not tested on "
                    "another drive of this size",
                )
            )
        return tuple(Limit(lack=name, reason=reason, most=MOST[name]) for name, reason in lacks)


def limits_as_recorded(recordings: Sequence[Recording], axis: str) -> tuple[Limit, ...]:
    """Return what is odd about drive and displacement of an axis, as reading the files told it."""
    return tuple(
        Limit(
            lack=statement.quantity,
            reason=f"{recording.name}: {statement.text.partition('. ')[0]}",
            most=AS_RECORDED[statement.quantity],
        )
        for recording in recordings
        for statement in recording.statements
        if statement.quantity in AS_RECORDED and statement.axis == axis
    )


def scope_of(pieces: Sequence[Piece]) -> Scope:
    """Return the scope of pieces."""
    branches = [branch for piece in pieces for branch in branches_of(piece)]
    largest = max((abs(branch.span) for branch in branches), default=0.0)
    large = [branch for branch in branches if abs(branch.span) > LARGE * largest]
    complete = [branch for branch in branches if branch.is_whole] or branches
    spans = [abs(branch.span) for branch in complete if abs(branch.span) > SMALL * largest]
    return Scope(
        branches=len(large),
        recordings=len({piece.recording for piece in pieces}),
        speeds=max(_speed_ratio(large, direction) for direction in (1.0, -1.0)),
        amplitudes=max(spans, default=1.0) / min(spans, default=1.0),
    )


def branches_of(piece: Piece) -> list[Branch]:
    """Return the monotone runs of a piece's drive, in their order."""
    drive = piece.fitted_drive
    turns = reversals_of(drive, max(noise_of(drive), 0.02))
    branches = []
    for first, stop in zip((0, *turns), (*turns, len(drive) - 1), strict=True):
        run = drive[first : stop + 1]
        span = float(run[-1] - run[0])
        if abs(span) <= 0.02 or len(run) < 3:
            continue
        # a rest in front of a run, or behind it, is none of it
        inside = np.abs(run - 0.5 * (run[0] + run[-1])) < 0.4 * abs(span)
        moving_s = max(int(np.count_nonzero(inside)), 1) / piece.sampling_rate_Hz
        branches.append(
            Branch(
                recording=piece.recording,
                span=span,
                speed_per_s=0.8 * abs(span) / moving_s,
                is_whole=first > 0 and stop < len(drive) - 1,
            )
        )
    return branches


def _speed_ratio(branches: Sequence[Branch], direction: float) -> float:
    """Return the largest speed ratio of two branches of one direction and similar span."""
    ordered = sorted((b for b in branches if b.span * direction > 0.0), key=lambda b: abs(b.span))
    largest, first = 1.0, 0
    for stop, branch in enumerate(ordered):
        while abs(branch.span) > ALIKE * abs(ordered[first].span):
            first += 1
        speeds = [similar.speed_per_s for similar in ordered[first : stop + 1]]
        largest = max(largest, max(speeds) / min(speeds))
    return largest
