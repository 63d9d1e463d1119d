"""Checks of recordings: each reports a problem of the data and changes nothing.

Start at plausibility.py. A check is a function that returns a list of statements, empty for clean
data: ``check_...(recording, axis)`` for an axis with drive and displacement,
``check_...(recording, lab)`` for a recording, or ``check_...(recordings)`` for the recordings of a
stage together.
May import recordings, the laboratory and signal statistics, but not the ingest that calls it.
To add a check, add a function to the file of its subject, or a new file, and its line in
``AXIS_CHECKS``, ``CHECKS`` or ``SET_CHECKS``; ``tests/records/test_checks.py`` runs them all over
clean recordings.
"""

from collections.abc import Callable, Sequence

from piezoid.errors import RecordingError
from piezoid.raw_counts import record_in_counts
from piezoid.records.checks.causality import check_early_turns, check_loop_direction
from piezoid.records.checks.command_range import check_command_range
from piezoid.records.checks.consistency import (
    check_consistency,
    check_copies,
    check_drive_ranges,
    check_mixed_units,
    refuse_inconsistent,
)
from piezoid.records.checks.coupled_drives import check_coupled_drives
from piezoid.records.checks.joined_recordings import check_joined_recordings
from piezoid.records.checks.plausibility import (
    check_commanded_displacement,
    check_feedback,
    check_feedback_of_set,
    check_gain,
    check_missing_channels,
)
from piezoid.records.checks.saturation import check_saturation
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording, counted_in
from piezoid.statement import Statement

CHECKS: tuple[Callable[[Recording, Lab], list[Statement]], ...] = (
    check_missing_channels,
    check_command_range,
    check_coupled_drives,
)
AXIS_CHECKS: tuple[Callable[[Recording, str], list[Statement]], ...] = (
    check_gain,
    check_loop_direction,
    check_early_turns,
    check_feedback,
    check_saturation,
    check_commanded_displacement,
    check_joined_recordings,
)
# Quantities of statements about a displacement that is not fitted.
UNUSABLE = frozenset({"not_measured", "wrapped"})
SetCheck = Callable[[Sequence[Recording]], list[Statement]]
# The second list compares only recordings that do not contradict the others.
SET_CHECKS: tuple[SetCheck, ...] = (check_mixed_units, check_consistency, check_copies)
SET_CHECKS_OF_CONSISTENT: tuple[SetCheck, ...] = (
    check_drive_ranges,
    check_feedback_of_set,
)


def check_recording(recording: Recording, lab: Lab) -> list[Statement]:
    """Run every check of one recording."""
    of_axes = [
        statement
        for axis in recording.complete_axes
        for check in AXIS_CHECKS
        for statement in check(recording, axis)
    ]
    return [*of_axes, *(statement for check in CHECKS for statement in check(recording, lab))]


def check_set(recordings: Sequence[Recording]) -> list[Statement]:
    """Run every check of the recordings of one stage together; statements name the recording."""
    statements = [statement for check in SET_CHECKS for statement in check(recordings)]
    inconsistent = {s.recording for s in statements if s.quantity != "copy"}
    consistent = [r for r in recordings if r.name not in inconsistent]
    statements += [s for check in SET_CHECKS_OF_CONSISTENT for s in check(consistent)]
    return list(record_in_counts(tuple(statements), counted_in(recordings)))


def refuse_unusable(recordings: Sequence[Recording]) -> None:
    """Refuse a displacement that was not measured, and recordings that contradict each other.

    Raises ``RecordingError`` with the sentence that ``piezoid inspect`` shows.
    """
    for recording in recordings:
        for statement in recording.statements:
            if statement.quantity in UNUSABLE:
                # A statement about a column names the column in place of the axis.
                axis = f", axis {statement.axis}" if statement.axis else ""
                raise RecordingError(
                    f"{recording.name}{axis}: {statement.text.rstrip('.')}",
                    needed="a displacement as the sensor measured it, within its range",
                    remedy="Correct the column or name another one in lab.toml, or leave the file "
                    "out.",
                )
    refuse_inconsistent(recordings)
