"""Rate dependence: the irreversible part of the response needs time.

What you see
    Loops open as the drive goes faster, large ones more than small ones: small fast motion,
    which moves no domain walls, is not delayed.
Why it happens
    Domain walls climb barriers by thermal activation; faster drives need a larger lead.
How it is detected
    The irreversible part of the static response, delayed in proportion to its speed or to the
    logarithm of its speed, explains what static hysteresis cannot, and explains it better than a
    lag of the whole response.
What the extension adds
    A lag of the irreversible part, linear in its speed or saturating to a logarithm.
Source
    Eyring (1936); Al Janaideh, Su & Rakheja (2008); Smith (2005)
"""

import numpy as np

from piezoid.diagnosis.effect import (
    OVER_SPEED,
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.signals import added_percent, with_displacement
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import activated, relaxed
from piezoid.records.recording import Recording

LINEAR_STRAIN = (
    1.0  # half strokes: strain from which the lag of the walls is linear in their speed
)
EXTENSION_SHARES = (0.03, 3.0)  # range of the share of the lag in the model
SHARES = (0.03, 5.0)  # physically possible coefficients
TIMES_s = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
STRAIN_RANGE = (1e-3, 1e9)  # without an upper limit, because a linear lag has no strain
TIME_RANGE_s = (2e-6, 0.3)
MIN_LAG = 1e-5  # of half the stroke: a smaller lag is not computed
MIN_REVERSALS = 8
ONE_LEVEL = 0.01  # of half the drive's range: reversals within it are at one level
SPEED = 50.0  # strokes per second at which the error of the injected lag is its share


def reversible(view: View) -> Array:
    """Fit the slope just after reversals, where no domain wall moves yet, as a line of the drive.

    Returns the coefficients (2,), the highest power first. The slope is constant if the drive
    turns at one level only, and 0 if there are too few reversals.
    """
    levels, slopes = [], []
    for track, static in zip(view.tracks, view.static, strict=True):
        turn, end = track.branches
        rise = track.drive[end] - track.drive[turn]
        levels.append(track.drive[turn])
        slopes.append((static[end] - static[turn]) / rise)
    if sum(map(len, levels)) < MIN_REVERSALS:
        return np.array([0.0, 0.0])
    level, slope = np.concatenate(levels), np.concatenate(slopes)
    if np.ptp(level) < ONE_LEVEL:
        return np.array([0.0, float(slope.mean())])
    return np.asarray(np.polyfit(level, slope, 1))


def _columns(view: View, parameters: Parameters) -> Array:
    bend, slope = reversible(view)
    time_s, strain = parameters["time_s"], parameters["strain"]

    def change(k: int, track: Track) -> Array:
        walls = view.static[k] - (slope + 0.5 * bend * track.drive) * track.drive
        if time_s * float(np.abs(np.diff(walls)).max()) * track.rate_Hz < MIN_LAG:
            return np.zeros(len(walls))
        if strain >= LINEAR_STRAIN:
            return np.asarray(relaxed(walls, time_s, track.rate_Hz) - walls)
        return np.asarray(activated(walls, time_s, track.rate_Hz, strain) - walls)

    return view.column(change)[:, None]


def inject(recording: Recording, share: float) -> Recording:
    """Delay the irreversible part with one time constant, which slow recordings do not show."""
    moved_m, drive_V = recording.displacement_m(), recording.voltage_V()
    slope = 0.6 * float(np.polyfit(drive_V, moved_m, 1)[0])
    walls_m = moved_m - slope * drive_V
    late_m = RateDependence(time_s=share / SPEED).irreversible(walls_m, recording.sampling_rate_Hz)
    return with_displacement(recording, moved_m + (late_m - walls_m))


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search.

    For slow motion a share of the lag is a lag with a shorter time and a smaller strain.
    """
    strain = estimate.parameters["strain"]
    share = float(np.clip(estimate.first_coefficient, *EXTENSION_SHARES))
    return (
        RateDependence(
            time_s=share * estimate.parameters["time_s"],
            strain_m=share * strain * setting.half_stroke_m if strain < LINEAR_STRAIN else 0.0,
        ),
    )


EFFECT = Effect(
    name="rate_dependence",
    explanation=__doc__ or "",
    unit="% of the stroke, largest rms",
    experiment="Record full and tenth-size loops at four rates over two decades: rate dependence "
    "opens the large ones only, a delay or a lag opens both.",
    control="The inverse is right at one speed only: identify the stage at the speed that you "
    "use, or leave the rest to the observer.",
    shows=OVER_SPEED,
    tangent=Tangent(
        advised=("sine_grid",),
        columns=lambda drive, _: -(np.gradient(drive.irreversible_m) * drive.rate_Hz)[:, None],
    ),
    confounded=("delay", "lag", "resonance", "slew_limit"),
    trials=lambda view: [
        Trial(
            columns=_columns(view, {"time_s": time_s, "strain": strain}),
            parameters={"time_s": time_s, "strain": strain},
            coefficient_range=SHARES,
            needs_time=True,
            free={"time_s": 1.8, "strain": 2.0},
            limits={"time_s": TIME_RANGE_s, "strain": STRAIN_RANGE},
        )
        for time_s in TIMES_s
        for strain in (LINEAR_STRAIN, 0.03)
    ],
    columns=_columns,
    size=added_percent(_columns),
    model_error=0.05,  # the law of activation differs between ceramics
    inject=inject,
    extend=extend,
    without=without_part(RateDependence),
)
