"""Cross coupling: this axis moves when another axis is driven.

What you see
    The displacement changes while the drive of this axis is constant and another drive moves.
Why it happens
    Flexures are not quite orthogonal, sensors are tilted, amplifiers share a ground.
How it is detected
    The drive of the other axis, its square and its plays explain what the hysteresis of this axis
    cannot; the same drives run backwards in time do not.
What the extension adds
    A static response to the drive of the other axis.
Source
    Devasia, Eleftheriou & Moheimani (2007)
"""

import numpy as np

from piezoid.diagnosis.effect import (
    Appearance,
    ConstantDriveData,
    Effect,
    EffectEstimate,
    SearchScaling,
    Tangent,
    Trial,
    unsigned,
    without_part,
)
from piezoid.diagnosis.signals import (
    GAPS,
    added_percent,
    other_axis_columns,
    with_added,
    with_extension,
)
from piezoid.identification.extensions.cross_axis import CrossAxis
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.numerics.robust import white_noise_rms
from piezoid.records.recording import Quantity, Recording

NAME = "cross_coupling"


def _other_drive(recording: Recording) -> tuple[Array, Array]:
    for channel in recording.channels:
        if channel.quantity is Quantity.VOLTAGE and channel.axis != recording.axis:
            return unsigned(channel.values)
    return unsigned(np.full(recording.samples, np.nan))


def _at_rest(data: ConstantDriveData) -> Array | str:
    other_drives = [
        channel.values[data.rows]
        for channel in data.recording.channels
        if channel.quantity is Quantity.VOLTAGE
        and channel.axis != data.axis
        and np.ptp(channel.values) > 10.0 * white_noise_rms(channel.values)
    ]
    if not other_drives:
        return "the drive of no other axis moves in it"
    return np.column_stack([u / max(float(np.ptp(u)), 1e-30) for u in other_drives])


def inject(recording: Recording, share: float) -> Recording:
    """Couple the axis to every other drive of the recording."""
    coupled = recording
    for channel in recording.channels:
        if channel.quantity is Quantity.VOLTAGE and channel.axis != recording.axis:
            extension = CrossAxis(
                axis=channel.axis,
                centre_V=float(channel.values.mean()),
                gain_m_per_V=1e-6,
                curvature_m_per_V_per_V=0.0,
            )
            coupled = with_extension(coupled, extension)
    change_m = coupled.displacement_m() - recording.displacement_m()
    return with_added(recording, change_m, share)


def extend(_: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search."""
    extensions = []
    for axis in sorted({axis for piece in setting.pieces for axis in piece.others_V}):
        drives = [piece.others_V[axis] for piece in setting.pieces if axis in piece.others_V]
        low, high = min(float(u.min()) for u in drives), max(float(u.max()) for u in drives)
        extensions.append(
            CrossAxis(
                axis=axis,
                centre_V=(high + low) / 2,
                reach_V=(high - low) / 2,
                gain_m_per_V=0.0,
                curvature_m_per_V_per_V=0.0,
                play_threshold_V=tuple(gap * (high - low) / 2 for gap in GAPS.tolist()),
                play_weight_m_per_V=(0.0,) * len(GAPS),
            )
        )
    return tuple(extensions)


EFFECT = Effect(
    name=NAME,
    explanation=__doc__ or "",
    unit="% of the stroke, largest rms",
    experiment="Hold this axis, drive the other one over its range in decaying loops, and "
    "record both drives and this displacement.",
    control="Feed the drive of the other axis forward; otherwise the loop must reject its "
    "effect as a disturbance.",
    shows=Appearance(
        label="drive of the other axis",
        unit="V",
        kind="classes",
        along=_other_drive,
        reading="Coupling: a line or a loop over the drive of the other axis.",
    ),
    tangent=Tangent(
        advised=("other_axis",),
        columns=lambda drive, _: (
            1e-6
            * np.column_stack([*drive.other_drives.values()] or [np.zeros(len(drive.voltage_V))])
        ),
    ),
    untestable=lambda view: (
        ""
        if any(track.other_drives for track in view.tracks)
        else "no recording holds the moving drive of another axis"
    ),
    trials=lambda view: [
        Trial(columns=other_axis_columns(view)),
        Trial(columns=other_axis_columns(view, backwards=True), physical=False),
    ],
    columns=lambda view, _: other_axis_columns(view),
    size=added_percent(lambda view, _: other_axis_columns(view)),
    model_error=0.06,  # by the hysteresis of the other axis, which the plays represent in part
    at_rest=_at_rest,
    inject=inject,
    extend=extend,
    without=without_part(CrossAxis),
)
