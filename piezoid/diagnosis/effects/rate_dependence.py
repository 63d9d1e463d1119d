"""Rate dependence: what is irreversible needs time to follow.

What you see
    Loops open as the drive goes faster, large ones more than small ones: small fast motion, which
    moves no walls, is not late at all.
Why it happens
    Domain walls climb barriers by thermal activation; faster drives need a larger lead.
How it is detected
    The irreversible part of the static response, later or behind by the logarithm of its speed,
    explains what static hysteresis cannot, better than a lag of the whole response does.
What the extension adds
    A lag of the irreversible part, linear in its speed or saturating to a logarithm.
Source
    Al Janaideh, Su & Rakheja (2008); Smith (2005)
"""

import numpy as np

from piezoid.diagnosis.effect import Effect, Parameters, Trial
from piezoid.diagnosis.signals import rate_of, relaxed, with_displacement
from piezoid.diagnosis.view import View
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

ALLOWED = (0.0, float("inf"))
BENDS = (0.0, 0.3, 3.0, 30.0, 300.0)  # times the largest speed: where lag turns logarithmic
TIMES_s = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2)
TURN = 0.05  # of the drive's range: how far a branch is still reversible


def reversible_slope(view: View) -> float:
    """Return the slope of the static response just behind reversals, where no wall moves."""
    slopes = []
    for track, static in zip(view.tracks, view.static, strict=True):
        step = np.sign(np.diff(track.drive))
        turns = np.flatnonzero(step[1:] * step[:-1] < 0) + 1
        turns = turns[:: max(len(turns) // 60, 1)]
        for turn in turns:
            after = track.drive[turn : turn + 4000]
            far = np.flatnonzero(np.abs(after - after[0]) > TURN)
            if len(far):
                there = turn + int(far[0])
                rise = track.drive[there] - track.drive[turn]
                slopes.append(float((static[there] - static[turn]) / rise))
    return float(np.median(slopes)) if slopes else 0.0


def _columns(view: View, parameters: Parameters) -> Array:
    slope, bend, time_s = reversible_slope(view), parameters["bend_s"], parameters["time_s"]

    def behind(k: int) -> Array:
        track = view.tracks[k]
        walls = view.static[k] - slope * track.drive
        if time_s > 0.0:
            return relaxed(walls, time_s, track.rate_Hz) - walls
        speed = rate_of(walls, track.rate_Hz)
        return -np.arcsinh(bend * speed) / bend if bend > 0.0 else -speed

    return view.of(lambda k, _: behind(k))[:, None]


def _trials(view: View) -> list[Trial]:
    fastest = max(
        float(np.quantile(np.abs(np.diff(h)), 0.99)) * t.rate_Hz
        for h, t in zip(view.static, view.tracks, strict=True)
    )
    ways = [{"bend_s": bend / fastest, "time_s": 0.0} for bend in BENDS]
    ways += [{"bend_s": 0.0, "time_s": time_s} for time_s in TIMES_s]
    return [Trial(columns=_columns(view, w), parameters=w, within=ALLOWED) for w in ways]


def inject(recording: Recording, share: float) -> Recording:
    """Let what does not follow the drive in proportion come late."""
    moved_m, drive_V = recording.displacement_m(), recording.voltage_V()
    slope = 0.6 * float(np.polyfit(drive_V, moved_m, 1)[0])
    walls_m = moved_m - slope * drive_V
    speed = rate_of(walls_m, recording.sampling_rate_Hz)
    behind_m = -np.arcsinh(speed / max(float(np.std(speed)), 1e-30))
    scale = share * float(np.ptp(moved_m)) / max(float(np.std(behind_m)), 1e-30)
    return with_displacement(recording, moved_m + scale * behind_m)


EFFECT = Effect(
    name="rate_dependence",
    explanation=__doc__ or "",
    unit="percent of the stroke, rms",
    experiment="Record full and tenth-size loops at four rates over two decades: rate dependence "
    "opens the large ones only, a delay or a lag opens both.",
    rivals=("delay", "lag"),
    trials=_trials,
    columns=_columns,
    inject=inject,
)
