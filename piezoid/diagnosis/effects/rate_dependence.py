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

from piezoid.diagnosis.appearance import OVER_SPEED
from piezoid.diagnosis.effect import (
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import added_percent, rate_of, with_displacement
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.rate_dependence import RateDependence
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed
from piezoid.operators.limits import activated
from piezoid.records.recording import Recording

LINEAR_STRAIN = 1.0  # half strokes: from here on the lag of the walls is as good as linear
SHARES = (0.03, 3.0)  # range of the share of the lag, which a search may divide differently
ALLOWED = (0.03, 5.0)
TIMES_s = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2)
WIDEST = 1.0  # strain from which the lag is as good as linear
STRAINS = (1e-3, 1e9)  # a lag that is as good as linear has no strain
LONGEST = (2e-6, 0.3)
TOO_LITTLE = 1e-5  # of half the stroke: an invisible lag
FEWEST = 8  # reversals
ONE_PLACE = 0.01  # of half the drive's range
SPEED = 50.0  # strokes per second at which the injected lag is the share that is asked for


def reversible(view: View) -> Array:
    """Fit the reversible slope just after reversals as a polynomial of the drive.

    Just after a reversal no domain wall moves yet. The slope is linear in the drive, (2,) highest
    power first, or constant if the drive turns at one level only.
    """
    levels, slopes = [], []
    for track, static in zip(view.tracks, view.static, strict=True):
        turn, end = track.branches
        rise = track.drive[end] - track.drive[turn]
        levels.append(track.drive[turn])
        slopes.append((static[end] - static[turn]) / rise)
    if sum(map(len, levels)) < FEWEST:
        return np.array([0.0, 0.0])
    where, slope = np.concatenate(levels), np.concatenate(slopes)
    if np.ptp(where) < ONE_PLACE:
        return np.array([0.0, float(slope.mean())])
    return np.asarray(np.polyfit(where, slope, 1))


def _columns(view: View, parameters: Parameters) -> Array:
    bend, slope = reversible(view)
    time_s, strain = parameters["time_s"], parameters["strain"]

    def behind(k: int) -> Array:
        track = view.tracks[k]
        walls = view.static[k] - (slope + 0.5 * bend * track.drive) * track.drive
        if time_s * float(np.abs(np.diff(walls)).max()) * track.rate_Hz < TOO_LITTLE:
            return np.zeros(len(walls))
        if strain >= WIDEST:
            return np.asarray(relaxed(walls, time_s, track.rate_Hz) - walls)
        return np.asarray(activated(walls, time_s, track.rate_Hz, strain) - walls)

    return view.of(lambda k, _: behind(k))[:, None]


def _trials(view: View) -> list[Trial]:
    return [
        Trial(
            columns=_columns(view, {"time_s": time_s, "strain": strain}),
            parameters={"time_s": time_s, "strain": strain},
            coefficient_range=ALLOWED,
            needs_time=True,
            free={"time_s": 1.8, "strain": 2.0},
            limits={"time_s": LONGEST, "strain": STRAINS},
        )
        for time_s in TIMES_s
        for strain in (WIDEST, 0.03)
    ]


def inject(recording: Recording, share: float) -> Recording:
    """Delay the irreversible part, by the share at SPEED strokes per second.

    One time constant for all recordings of a stage: slow ones do not show it.
    """
    moved_m, drive_V = recording.displacement_m(), recording.voltage_V()
    slope = 0.6 * float(np.polyfit(drive_V, moved_m, 1)[0])
    walls_m = moved_m - slope * drive_V
    late_m = RateDependence(time_s=share / SPEED).irreversible(walls_m, recording.sampling_rate_Hz)
    return with_displacement(recording, moved_m + (late_m - walls_m))


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """A share of the lag is a lag of a shorter time and a smaller strain, where motion is slow."""
    strain, share = (
        estimate.parameters["strain"],
        float(np.clip(estimate.first_coefficient, *SHARES)),
    )
    bends = strain < LINEAR_STRAIN
    return (
        RateDependence(
            time_s=share * estimate.parameters["time_s"],
            strain_m=share * strain * setting.half_stroke_m if bends else 0.0,
        ),
    )


EFFECT = Effect(
    name="rate_dependence",
    explanation=__doc__ or "",
    unit="% of the stroke, rms where most",
    experiment="Record full and tenth-size loops at four rates over two decades: rate dependence "
    "opens the large ones only, a delay or a lag opens both.",
    control="The inverse is right at one speed only: identify the stage at the speed that you "
    "use, or leave the rest to the observer.",
    shows=OVER_SPEED,
    tangent=Tangent(columns=lambda drive, _: -rate_of(drive.walls_m, drive.rate_Hz)[:, None]),
    confounded=("delay", "lag", "resonance", "slew_limit"),
    trials=_trials,
    columns=_columns,
    size=added_percent(_columns),
    model_error=0.05,  # how walls wait is not the same in every law
    inject=inject,
    extend=extend,
    without=without_part(RateDependence),
)
