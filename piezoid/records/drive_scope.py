"""Scope of recordings: branches, speeds and amplitudes of their drives, which limit every fit.

No residual shows a branch, a speed or an amplitude that was never recorded.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from piezoid.numerics.arrays import Array
from piezoid.records.checks import UNUSABLE
from piezoid.records.checks.plausibility import is_held_throughout
from piezoid.records.drive_signal import is_at_rest, noise_of, reversals_of
from piezoid.records.recording import Recording
from piezoid.statement import Statement, finding

MIN_SPAN = 0.02  # half ranges: a smaller branch is noise
LARGE = 0.2  # of the largest span: a branch that shows a loop
SMALL = 0.02  # of the largest span: a smaller branch is no reversal
ONE_LOOP = 3  # branches: from the middle up, down and back
SIMILAR_SPANS = 1.5  # largest ratio of the span of a fast branch to that of a slow one
MIN_SPEED_RATIO = 2.0  # doubles the loop width caused by a lag, beyond any uncertainty
MIN_SPEED = 0.1  # of the mean speed: a drive that is slower for half of the time rests
MIN_PATH = 0.5  # of the path of a sweep, in its large branches
REMEDIES = {
    "branch": "Record whole cycles of the drive, up and down, several times.",
    "loop": "Record at least two cycles, and some of smaller size.",
}


@dataclass(frozen=True, kw_only=True)
class DriveScope:
    """Properties of the drives of an axis that limit what a fit can identify.

    branches    number of large branches
    recordings  number of recordings
    speeds      ratio of the speed of a branch to that of a slower one of the same direction that
                is not clearly smaller: a smaller loop is narrower by hysteresis, and wider by a
                lag if it is faster
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

    @property
    def missing_branches(self) -> tuple[str, str] | None:
        """What is too little for any fit of hysteresis: the lack, and a clause; None: enough."""
        if self.branches < 2:
            return "branch", (
                "only one branch was recorded: hysteresis is the difference of two, and none was "
                "measured"
            )
        if self.is_untested:
            return "loop", (
                "only one loop was recorded: no part of it can be left out to test the model on"
            )
        return None


def drive_scope(drives: Iterable[tuple[int, Array, float]]) -> DriveScope:
    """Return the scope of drives: properties of their monotone runs.

    drives  number of the recording, drive in half ranges, sampling rate in Hz
    """
    numbers = set()
    spans, speeds, is_whole = [], [], []  # of each run: signed; per s; from reversal to reversal
    for number, drive, rate_Hz in drives:
        numbers.add(number)
        reversals = reversals_of(drive, max(noise_of(drive), MIN_SPAN))
        for first, stop in zip((0, *reversals), (*reversals, len(drive) - 1), strict=True):
            run = drive[first : stop + 1]
            span = float(run[-1] - run[0])
            if abs(span) <= MIN_SPAN or len(run) < 3:
                continue
            # The middle 80 % of the span, without rests before or after the run.
            is_middle = np.abs(run - 0.5 * (run[0] + run[-1])) < 0.4 * abs(span)
            moving_s = max(int(np.count_nonzero(is_middle)), 1) / rate_Hz
            spans.append(span)
            speeds.append(0.8 * abs(span) / moving_s)
            is_whole.append(first > 0 and stop < len(drive) - 1)
    size, speed = np.abs(spans), np.array(speeds)
    speed_ratio = 1.0
    for sign in (1.0, -1.0):
        branch = np.flatnonzero(sign * np.array(spans) > 0.0)
        for span, fast in zip(size[branch], speed[branch], strict=True):
            slowest = speed[branch[SIMILAR_SPANS * size[branch] >= span]].min()
            speed_ratio = max(speed_ratio, float(fast / slowest))
    complete = size[is_whole] if any(is_whole) else size
    complete = complete[complete > SMALL * size.max(initial=0.0)]
    return DriveScope(
        branches=int((size > LARGE * size.max(initial=0.0)).sum()),
        recordings=len(numbers),
        speeds=speed_ratio,
        amplitudes=float(complete.max() / complete.min()) if len(complete) else 1.0,
    )


def scope_statements(recordings: Sequence[Recording]) -> list[Statement]:
    """Report recordings of an axis that are together too little for a fit of hysteresis.

    Steps, holds, chirps, noise and recordings in closed loop are not for this fit.
    """
    statements = []
    usable = [r for r in recordings if UNUSABLE.isdisjoint(s.quantity for s in r.statements)]
    for axis in sorted({axis for recording in usable for axis in recording.complete_axes}):
        sweeps = [r for r in usable if axis in r.complete_axes and _is_sweep(r, axis)]
        if not sweeps:
            continue
        drives_V = [recording.voltage_V(axis) for recording in sweeps]
        half_V = 0.5 * float(np.ptp(np.concatenate(drives_V)))
        scope = drive_scope(
            (number, drive_V[rows] / half_V, recording.sampling_rate_Hz)
            for number, (recording, drive_V) in enumerate(zip(sweeps, drives_V, strict=True))
            for rows in recording.pieces
        )
        if scope.missing_branches is None:
            continue
        lack, reason = scope.missing_branches
        text = f"Too little for a fit of hysteresis: {reason}. {REMEDIES[lack]}"
        statements += [finding(lack, text, axis=axis, recording=r.name) for r in sweeps]
    return statements


def _is_sweep(recording: Recording, axis: str) -> bool:
    """Return whether a drive moves most of the time, and mostly along large branches.

    Steps and holds rest. Most of the path of a small chirp, or of noise, is in small branches.
    """
    drive_V, displacement_m = recording.voltage_V(axis), recording.displacement_m(axis)
    if is_at_rest(drive_V, displacement_m) or is_held_throughout(recording, axis):
        return False
    steps_V = np.abs(np.diff(drive_V))
    turns = reversals_of(drive_V, max(noise_of(drive_V), 0.5 * MIN_SPAN * float(np.ptp(drive_V))))
    branches_V = np.abs(np.diff(drive_V[[0, *turns, -1]]))
    large_V = branches_V[branches_V > LARGE * branches_V.max()]
    is_moving = float(np.median(steps_V)) > MIN_SPEED * float(steps_V.mean())
    return is_moving and float(large_V.sum()) > MIN_PATH * float(steps_V.sum())
