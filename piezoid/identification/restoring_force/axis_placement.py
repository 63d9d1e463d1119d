"""Where the hysteresis of a fitted axis stands, asked of the recording that shows a mode most."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from piezoid.errors import ExcitationError, RecordingError
from piezoid.identification.dynamics.axis_dynamics import mode_in
from piezoid.identification.model import AxisModel
from piezoid.identification.restoring_force.fit import fit_restoring_force
from piezoid.identification.restoring_force.placing import HysteresisPlacement, placed
from piezoid.identification.restoring_force.task import FEWEST, drive_and_motion
from piezoid.operators.hysteretic_mode import Hold
from piezoid.records.recording import Recording

# So many samples take a minute; a longer recording is asked in its first part.
MOST = 16384
HOLDS: tuple[Hold, ...] = ("zero_order", "band_limited")


def with_placement(
    axis: AxisModel,
    recordings: Sequence[Recording],
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> AxisModel:
    """Return the axis with the place of its hysteresis, where that is open and a mode shows.

    It is open where the model class, hysteresis before linear dynamics, does not apply, or where
    the harmonics of a joint fit do not say ``before``. Inside a mode the axis gets that mode as
    its simulation, and no controller.
    """
    is_before = axis.joint is not None and axis.joint.structure.order == "before"
    if axis.verdict.applies and (axis.joint is None or is_before):
        return axis
    shown = mode_in(recordings, axis.axis, axis.rig)
    if shown is None or shown.samples < FEWEST:
        return axis
    progress("asking where the hysteresis stands")
    try:
        drive, motion_m = drive_and_motion(shown, axis.axis)
        drive, motion_m = drive[:MOST], motion_m[:MOST]
        # How a drive goes on between its samples no file says: what predicts better is believed.
        tried = {
            hold: placed(drive, motion_m, shown.sampling_rate_Hz, hold=hold) for hold in HOLDS
        }
        hold = min(HOLDS, key=lambda one: _least_m(tried[one]))
        found, swing = tried[hold], None
        if found.place == "inside":
            progress("fitting the mode with a hysteretic spring")
            swing = fit_restoring_force(drive, motion_m, shown.sampling_rate_Hz, hold=hold)
    except (ExcitationError, RecordingError):
        return axis
    remark = f"{shown.name}: {found.text}"
    return replace(
        axis,
        placement=found,
        restoring_force=swing,
        verdict=replace(axis.verdict, remarks=(*axis.verdict.remarks, remark)),
    )


def _least_m(found: HysteresisPlacement) -> float:
    """Return the error of the place that predicts best; infinite where no mode shows."""
    rms = list(found.left_out_rms_m.values())
    return min([*rms, found.without_rms_m or np.inf], default=np.inf)
