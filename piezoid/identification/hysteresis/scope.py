"""Scope of recordings: limits to what a fit can identify, found before the fit.

No residual shows a branch, a speed or an amplitude that was never recorded. Each such lack becomes
a sentence and an upper bound of the score.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.quality import Limit
from piezoid.records.drive_signal import noise_of, reversals_of
from piezoid.records.recording import Recording

LARGE = 0.2  # of the largest span: a branch that shows a loop
SMALL = 0.02  # of the largest span: a smaller branch is no reversal
ONE_LOOP = 3  # branches: from the middle up, down and back
SIMILAR_SPANS = 1.5  # largest ratio of spans at which the speeds of two branches are compared
MIN_SPEED_RATIO = 2.0  # doubles the loop width caused by a lag, beyond any uncertainty
MIN_AMPLITUDE_RATIO = 1.25  # of spans between reversals, largest over smallest
# Upper bounds of the score: never "good" (90), and at most "usable with care" (50) if the
# existence or the cause of a loop is unknown.
MAX_SCORE = {"branch": 20, "loop": 40, "speed": 50, "amplitude": 70, "recording": 85}
# The same for checks of drive and displacement when the files are read.
MAX_SCORE_AS_RECORDED = {
    "closed_loop": 40,
    "leads": 50,
    "smoothed": 50,
    "implausible_gain": 70,
    "stands": 70,
    "zero_jump": 85,
}


@dataclass(frozen=True, kw_only=True)
class Scope:
    """Properties of the recordings that limit what a fit can identify.

    branches    number of large branches
    recordings  number of recordings
    speeds      ratio of the fastest to the slowest among similar branches of one direction
    amplitudes  ratio of the largest span to the smallest between two reversals
    """

    branches: int
    recordings: int
    speeds: float
    amplitudes: float

    @property
    def is_untested(self) -> bool:
        """Whether the only recording is a single loop, of which no part can be held out."""
        return self.recordings == 1 and self.branches <= ONE_LOOP

    @property
    def has_one_speed(self) -> bool:
        """Whether loop width and lag cannot be separated."""
        return self.speeds < MIN_SPEED_RATIO

    def limits(self, lag: str = "") -> tuple[Limit, ...]:
        """Return what was not measured, most important first.

        lag  comparison with a lag without hysteresis
        """
        rules = (
            (
                self.branches < 2,
                "branch",
                "only one branch was recorded: hysteresis is the difference of two, and none was "
                "measured; the error is that of the fit",
            ),
            (
                self.branches >= 2 and self.is_untested,
                "loop",
                "only one loop was recorded: no part of it can be left out to test the model on, "
                "and the error is that of the fit",
            ),
            (
                self.branches >= 2 and self.has_one_speed,
                "speed",
                "branches of one size were all driven at one speed: loop width and lag cannot be "
                f"separated{lag}",
            ),
            (
                self.amplitudes < MIN_AMPLITUDE_RATIO,
                "amplitude",
                "every branch has one amplitude: no smaller loop was ever measured",
            ),
            (
                self.recordings == 1,
                "recording",
                "only one recording determines the hysteresis: the model was not tested on "
                "a second drive over this range",
            ),
        )
        return tuple(
            Limit(lack=lack, reason=reason, most=MAX_SCORE[lack])
            for applies, lack, reason in rules
            if applies
        )


def limits_as_recorded(recordings: Sequence[Recording], axis: str) -> tuple[Limit, ...]:
    """Return a limit for each failed check of drive and displacement as recorded."""
    return tuple(
        Limit(
            lack=statement.quantity,
            reason=f"{recording.name}: {statement.text.partition('. ')[0]}",
            most=MAX_SCORE_AS_RECORDED[statement.quantity],
        )
        for recording in recordings
        for statement in recording.statements
        if statement.quantity in MAX_SCORE_AS_RECORDED and statement.axis == axis
    )


def scope_of(pieces: Sequence[Piece]) -> Scope:
    """Return the scope of pieces: properties of the monotone runs of their scaled drives."""
    spans, speeds, is_whole = [], [], []  # of each run: signed; per s; from reversal to reversal
    for piece in pieces:
        drive = piece.fitted_drive
        reversals = reversals_of(drive, max(noise_of(drive), 0.02))
        for first, stop in zip((0, *reversals), (*reversals, len(drive) - 1), strict=True):
            run = drive[first : stop + 1]
            span = float(run[-1] - run[0])
            if abs(span) <= 0.02 or len(run) < 3:
                continue
            # The middle 80 % of the span, without rests before or after the run.
            is_middle = np.abs(run - 0.5 * (run[0] + run[-1])) < 0.4 * abs(span)
            moving_s = max(int(np.count_nonzero(is_middle)), 1) / piece.sampling_rate_Hz
            spans.append(span)
            speeds.append(0.8 * abs(span) / moving_s)
            is_whole.append(first > 0 and stop < len(drive) - 1)
    size, speed = np.abs(spans), np.array(speeds)
    is_large = size > LARGE * size.max(initial=0.0)
    speed_ratio = 1.0  # of two large branches of one direction and similar span
    for sign in (1.0, -1.0):
        branch = np.flatnonzero(is_large & (sign * np.array(spans) > 0.0))
        branch = branch[np.argsort(size[branch], kind="stable")]
        first = 0
        for stop in range(len(branch)):
            while size[branch[stop]] > SIMILAR_SPANS * size[branch[first]]:
                first += 1
            similar = speed[branch[first : stop + 1]]
            speed_ratio = max(speed_ratio, float(similar.max() / similar.min()))
    complete = size[is_whole] if any(is_whole) else size
    complete = complete[complete > SMALL * size.max(initial=0.0)]
    return Scope(
        branches=int(is_large.sum()),
        recordings=len({piece.recording for piece in pieces}),
        speeds=speed_ratio,
        amplitudes=float(complete.max() / complete.min()) if len(complete) else 1.0,
    )
