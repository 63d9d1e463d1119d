"""Slew limit: the current of the amplifier limits the speed of the drive.

What you see
    Below some speed the model is right; above it the motion is a straight line that comes late.
Why it happens
    A ceramic is a large capacitor, and an amplifier has a largest current.
How it is detected
    The static response to a drive of limited speed explains what the response to the command
    cannot, with a share near one and a limit below the fastest drive.
What the extension adds
    The limit in front of the hysteresis; the remedy is a slower trajectory.
Source
    Fleming & Moheimani (2005)
"""

import numpy as np

from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.effect import OVER_SPEED, Effect, Parameters, Tangent, Trial, without_part
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import drive_change, stroke_of, with_displacement
from piezoid.identification.extensions.amplifier_limits import SlewLimit
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import slewed
from piezoid.records.recording import Recording

SHARES = (0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.92)  # of the fastest drive
LOW_SHARES = (0.06, 0.09, 0.13, 0.18)  # without a tangent, which would resemble any effect
FASTEST_QUANTILE = 0.999  # of the speed, to ignore single jumps of a staircase
PLANNED = 0.7  # of the fastest speed along the drive, in a plan


def _slew_limited(drive: Array, rate_Hz: float, parameters: Parameters) -> Array:
    step = parameters["limit_per_s"] / rate_Hz
    return slewed(drive, step) if np.any(np.abs(np.diff(drive)) > step) else drive


def _trials(view: View) -> list[Trial]:
    fastest = max(
        float(np.quantile(np.abs(np.diff(track.command)), FASTEST_QUANTILE)) * track.rate_Hz
        for track in view.tracks
    )
    no_tangent = np.zeros((len(view.response), 1))
    limits = [(share, {"limit_per_s": share * fastest}) for share in (*LOW_SHARES, *SHARES)]
    return [
        Trial(
            columns=drive_change(view, _slew_limited, limit) if share in SHARES else no_tangent,
            parameters=limit,
            needs_time=True,
            free={"limit_per_s": 1.12},
        )
        for share, limit in limits
    ]


def _tangent(drive: DriveResponse, _: float) -> Array:
    """Return the motion that a slew limit at a share of the largest speed removes."""
    limit_V_per_s = PLANNED * drive.model.certificate.slew_V_per_s
    output_V = _slew_limited(drive.voltage_V, drive.rate_Hz, {"limit_per_s": limit_V_per_s})
    gain = float(np.sum(drive.model.hysteresis.plays.weight))
    return np.asarray(gain * (output_V - drive.voltage_V)[:, None])


def inject(recording: Recording, share: float) -> Recording:
    """Limit the slew rate such that the rms error is the share of the stroke."""
    moved_m = recording.displacement_m()
    fastest_m = float(np.abs(np.diff(moved_m)).max())
    steps_m = fastest_m * np.geomspace(1.0, 0.05, 25)
    missed = [float(np.std(slewed(moved_m, step) - moved_m)) for step in steps_m]
    step_m = float(np.interp(share * stroke_of(recording), missed, steps_m))
    return with_displacement(recording, slewed(moved_m, step_m))


EFFECT = Effect(
    name="slew_limit",
    explanation=__doc__ or "",
    unit="V/s, at the command",
    model_error=0.002,
    experiment="Record full triangles at rising rates with the monitor output of the "
    "amplifier: its slope stops rising at the limit.",
    control="Fast large ramps arrive late with any controller: limit the speed of the reference.",
    shows=OVER_SPEED,
    tangent=Tangent(columns=_tangent, advised=("fast_ramps",)),
    confounded=("delay", "lag", "rate_dependence"),
    trials=_trials,
    drive_filter=_slew_limited,
    size=lambda view, parameters, _: view.voltage_V * parameters["limit_per_s"],
    inject=inject,
    extend=lambda estimate, setting: (
        SlewLimit(limit_V_per_s=estimate.parameters["limit_per_s"] * setting.voltage_V),
    ),
    without=without_part(SlewLimit),
)
