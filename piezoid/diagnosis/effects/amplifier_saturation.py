"""Amplifier saturation: the supply limits the voltage before the command does.

What you see
    The tips of loops are flat: the command goes on, the displacement does not.
Why it happens
    The output of the amplifier cannot exceed its supply, and the ceramic sees the clipped voltage.
How it is detected
    The static response to a clipped drive explains what the response to the command cannot, with a
    share near one and at the same level in every recording.
What the extension adds
    The limit in front of the hysteresis; the remedy is a smaller range or another supply.
Source
    data sheets of high-voltage amplifiers; Fleming & Leang (2014)
"""

import numpy as np

from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.effect import (
    OVER_DRIVE,
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import drive_change, stroke_of, with_displacement
from piezoid.identification.extensions.amplifier_limits import AmplifierLimits
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

DEPTHS = (0.01, 0.02, 0.04, 0.07, 0.11, 0.16, 0.24)  # below the end of the drive
LARGE_DEPTHS = (0.4, 0.6, 0.8, 1.0, 1.2)  # without a tangent, which would resemble any effect
MIN_RANGE = 0.05  # share of the drive's range between the limits
MIN_STEP, STEP = 0.015, 0.06  # of the refit, the second over the depth: seven reach the next depth
CLIPPED_AT = 0.94  # of the range, about its middle, in a plan


def _clip(drive: Array, _: float, parameters: Parameters) -> Array:
    low, high = parameters.get("low", -np.inf), parameters.get("high", np.inf)
    if np.all((drive >= low) & (drive <= high)):
        return drive
    return np.clip(drive, low, high)


def _command_range(view: View) -> tuple[float, float]:
    low = min(float(track.command.min()) for track in view.tracks)
    return low, max(float(track.command.max()) for track in view.tracks)


def _trials(view: View) -> list[Trial]:
    low, high = _command_range(view)
    margin, middle = MIN_RANGE * (high - low), 0.5 * (high + low)
    no_tangent = np.zeros((len(view.response), 1))
    candidates = [
        (depth, levels, limits)
        for depth in (*DEPTHS, *LARGE_DEPTHS)
        for levels, limits in (
            ({"high": high - depth}, {"high": (low + margin, np.inf)}),
            ({"low": low + depth}, {"low": (-np.inf, high - margin)}),
            (
                {"high": high - depth, "low": low + depth},
                {"high": (middle + margin, np.inf), "low": (-np.inf, middle - margin)},
            ),
        )
    ]
    return [
        Trial(
            columns=drive_change(view, _clip, levels) if depth in DEPTHS else no_tangent,
            parameters=levels,
            free=dict.fromkeys(levels, max(MIN_STEP, STEP * depth)),
            limits=limits,
        )
        for depth, levels, limits in candidates
        if all(limits[side][0] < level < limits[side][1] for side, level in levels.items())
    ]


def _size(view: View, parameters: Parameters, _: Array) -> float:
    low, high = _command_range(view)
    cut = max(high - parameters.get("high", high), parameters.get("low", low) - low)
    return 100.0 * cut / (high - low)


def _tangent(drive: DriveResponse, _: float) -> Array:
    """Return the motion beyond CLIPPED_AT of the range, above and below."""
    low_V, high_V = drive.model.voltage_V
    unit = (2.0 * drive.voltage_V - low_V - high_V) / (high_V - low_V)
    over, under = np.maximum(unit - CLIPPED_AT, 0.0), np.minimum(unit + CLIPPED_AT, 0.0)
    gain_m = float(np.sum(drive.model.hysteresis.plays.weight)) * drive.half_range_V
    return -gain_m * np.column_stack([over, under])


def inject(recording: Recording, share: float) -> Recording:
    """Clip the displacement at the top, by a share of the stroke."""
    moved_m = recording.displacement_m()
    return with_displacement(
        recording, np.minimum(moved_m, moved_m.max() - share * stroke_of(recording))
    )


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search.

    Drives lie between -1 and 1: a limit outside was never reached and is not included.
    """
    level_V = {
        side: setting.voltage_offset_V + setting.voltage_V * estimate.parameters[side]
        for side in ("low", "high")
        if abs(estimate.parameters.get(side, np.inf)) < 1.0
    }
    if not level_V:
        return ()
    return (AmplifierLimits(low_V=level_V.get("low"), high_V=level_V.get("high")),)


EFFECT = Effect(
    name="amplifier_saturation",
    explanation=__doc__ or "",
    unit="% of the drive range that is cut off",
    experiment="Record slow loops to the full range and to four fifths of it, with the "
    "monitor output of the amplifier: only the first are clipped.",
    control="Beyond the limit the drive has no effect: reduce the range, or the integrator "
    "winds up.",
    shows=OVER_DRIVE,
    tangent=Tangent(columns=_tangent),
    confounded=("slew_limit",),
    trials=_trials,
    drive_filter=_clip,
    size=_size,
    inject=inject,
    extend=extend,
    without=without_part(AmplifierLimits),
    detectable_share=8e-3,
)
