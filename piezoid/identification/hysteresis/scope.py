"""Scope of recordings: limits to what a fit can identify, found before the fit.

No residual shows a branch, a speed or an amplitude that was never recorded. Each such lack becomes
a sentence and an upper bound of the score.
"""

from collections.abc import Sequence

from piezoid.identification.hysteresis.pieces import Piece
from piezoid.identification.quality import Limit
from piezoid.records.drive_scope import DriveScope, drive_scope
from piezoid.records.recording import Recording

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


def limits_of(scope: DriveScope, lag: str = "") -> tuple[Limit, ...]:
    """Return what was not measured, most important first.

    lag  comparison with a lag without hysteresis
    """
    reasons = {}
    if scope.missing_branches is not None:
        lack, reason = scope.missing_branches
        reasons[lack] = f"{reason}; the error is that of the fit"
    if scope.branches >= 2 and scope.has_one_speed:
        reasons["speed"] = (
            "branches of one size were all driven at one speed: loop width and lag cannot be "
            f"separated{lag}"
        )
    if scope.amplitudes < MIN_AMPLITUDE_RATIO:
        reasons["amplitude"] = "every branch has one amplitude: no smaller loop was ever measured"
    if scope.recordings == 1:
        reasons["recording"] = (
            "only one recording determines the hysteresis: the model was not tested on a second "
            "drive over this range"
        )
    return tuple(
        Limit(lack=lack, reason=reason, most=MAX_SCORE[lack]) for lack, reason in reasons.items()
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


def scope_of(pieces: Sequence[Piece]) -> DriveScope:
    """Return the scope of the fitted rows of pieces."""
    return drive_scope(
        (piece.recording, piece.fitted_drive, piece.sampling_rate_Hz) for piece in pieces
    )
