"""Creep: the stage goes on moving after the drive has stopped, ever more slowly.

What you see
    During a hold the displacement goes on in the direction of the last step, by about the same
    amount in every decade of time; repeated loops close late.
Why it happens
    Domains climb barriers of widely spread heights: relaxation times are spread evenly over the
    logarithm of time.
How it is detected
    The static response behind lags of log-spaced time constants explains what static hysteresis
    cannot, with the sign of the drive, better than the same relaxation run backwards in time.
    The barriers are spread nearly evenly. Several spectra are tried, which rise or fall slightly
    with the logarithm of time and begin with the whole or half of the fastest rung,

        c(t) = a integral (1 + b log10(tau / 10 s)) h_tau(t) d log10 tau,

    with h the static response. The size is a, the share of a step in the decade around ten
    seconds.
What the extension adds
    A ladder of relaxations behind the hysteresis, with equal shares for each decade.
Source
    Jung & Gweon (2000); Kuhnen & Krejci (2009); Vieira (1986)
"""

import numpy as np

from piezoid.diagnosis.drive_response import DriveResponse
from piezoid.diagnosis.effect import (
    Appearance,
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
from piezoid.diagnosis.signals import with_added, with_extension
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.extension import Extension
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import ladder
from piezoid.records.recording import Recording

RUNGS = 8  # of a creep ladder in the model: as many as the runtime has
PER_DECADE = 2
FASTEST_s = 0.01
DECAY_s = 30.0  # of creep from before a track; slower creep is part of its zero
SLOWEST = 10.0  # slowest time constant over the longest track
REFERENCE_s = 10.0  # time at which the spectrum has the size of the effect
# Spectra: the relative change per decade, and the share of the fastest rung that is present.
SPECTRA = tuple(
    {"tilt": tilt, "begins": share} for tilt in (0.0, -0.15, 0.15) for share in (1.0, 0.5)
)
SHARES = (0.0, 0.1)  # physically possible shares of a step per decade
MIN_DURATION_s = 2.0  # a shorter recording shows no slow motion
PLANNED_s = (0.03, 3000.0)  # time constants in a plan
HOLD_CHANGE = 1e-4  # of the drive's range: a smaller change is a hold
MIN_HOLD_s = 0.2  # of a hold in the picture


def _ladder(view: View, parameters: Parameters, *, backwards: bool = False) -> Array:
    """Return the relaxation of the static response with a coefficient of a whole step per decade.

    backwards  whether to run the relaxation backwards in time, for a placebo
    """
    first, stop = np.log10([FASTEST_s, SLOWEST * view.longest_s])
    decade = np.arange(first + 0.5 / PER_DECADE, stop, 1.0 / PER_DECADE)
    share = 1.0 + parameters["tilt"] * (decade - np.log10(min(REFERENCE_s, view.longest_s)))
    share[0] *= parameters["begins"]
    times_s, share = (10.0**decade).tolist(), np.maximum(share, 0.0) / PER_DECADE
    order = slice(None, None, -1 if backwards else 1)

    def relax(k: int, track: Track) -> Array:
        return ladder(view.static[k][order], times_s, track.rate_Hz, share)[order]

    return view.column(relax)[:, None]


def _tangent(drive: DriveResponse, _: float) -> Array:
    first, stop = np.log10(PLANNED_s)
    times_s = np.logspace(first, stop, round((stop - first) * PER_DECADE))
    return ladder(drive.static_m, times_s.tolist(), drive.rate_Hz, 1.0 / PER_DECADE)[:, None]


def _in_holds(recording: Recording) -> tuple[Array, Array]:
    """Return decades of time since the drive stopped, and the direction of its last move."""
    voltage_V, rate_Hz = recording.voltage_V(), recording.sampling_rate_Hz
    step = np.diff(voltage_V, prepend=voltage_V[0])
    is_moving = np.abs(step) > HOLD_CHANGE * max(float(np.ptp(voltage_V)), 1e-30)
    last_move = np.maximum.accumulate(np.where(is_moving, np.arange(len(step)), 0))
    elapsed_s = (np.arange(len(step)) - last_move) / rate_Hz
    with np.errstate(divide="ignore"):
        decades = np.where(is_moving | (elapsed_s <= 0.0), np.nan, np.log10(elapsed_s))
    hold_ends = np.flatnonzero(np.diff(np.append(is_moving, True).astype(int)) > 0)
    for end in hold_ends:
        if elapsed_s[end] < MIN_HOLD_s:
            decades[last_move[end] : end + 1] = np.nan
    return np.asarray(decades), np.asarray(np.sign(step[last_move]))


def inject(recording: Recording, share: float) -> Recording:
    """Add logarithmic creep of the displacement."""
    times_s = np.geomspace(0.03, 3.0 * float(recording.time_s[-1]) + 0.1, 9)
    creep = CreepLadder(time_s=tuple(times_s.tolist()), share=(0.1,) * 9)
    change_m = with_extension(recording, creep).displacement_m() - recording.displacement_m()
    return with_added(recording, change_m - change_m.mean(), share)


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the creep share of the search."""
    longest_s = max(piece.samples / piece.rate_Hz for piece in setting.pieces)
    time_s = np.geomspace(FASTEST_s, SLOWEST * longest_s, RUNGS)
    share = np.clip(estimate.first_coefficient * np.log10(time_s[1] / time_s[0]), 1e-4, 0.1)
    return (CreepLadder(time_s=tuple(time_s.tolist()), share=(float(share),) * RUNGS, even=True),)


EFFECT = Effect(
    name="creep",
    explanation=__doc__ or "",
    unit="% of a step per decade of time",
    # on 25 stages of thirteen laws: 14 % rms
    model_error=0.15,
    experiment="Record a staircase of random levels, up and down, each held for eight seconds or "
    "more, and the same staircase mirrored. Creep goes on in every hold and changes sign with the "
    "steps; drift keeps its sign, and an initial state ends with the first full cycle.",
    control="With feedforward alone the position drifts after every step. Integral action removes "
    "the drift within its bandwidth; the exported inverse contains the creep of the model.",
    shows=Appearance(
        label="time in a hold",
        unit="s",
        decades=True,
        kind="classes",
        along=_in_holds,
        reading="Multiplied by the direction of the last step. Creep: the same change in "
        "every decade.",
    ),
    tangent=Tangent(
        columns=_tangent,
        advised=("held_levels_mirrored", "held_levels"),
    ),
    confounded=("thermal_drift",),
    may_be_loop_shape=True,
    untestable=lambda view: (
        ""
        if view.longest_s >= MIN_DURATION_s
        else f"the longest recording lasts {view.longest_s:.4g} s; creep needs "
        f"{MIN_DURATION_s:g} s or more"
    ),
    trials=lambda view: [
        Trial(
            columns=_ladder(view, spectrum, backwards=backwards),
            parameters=spectrum,
            physical=not backwards,
            coefficient_range=SHARES,
        )
        for spectrum in SPECTRA
        for backwards in (False, True)
    ],
    # one exponential decay for each track: creep from before the recording
    covariates=lambda view: np.column_stack(
        [
            view.track_column(k, np.exp(-track.rows / (track.rate_Hz * DECAY_s)))
            for k, track in enumerate(view.tracks)
        ]
    ),
    columns=_ladder,
    size=lambda _, __, coefficient: 100.0 * float(coefficient[0]),
    inject=inject,
    extend=extend,
    without=without_part(CreepLadder),
)
