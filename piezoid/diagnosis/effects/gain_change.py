"""Gain change: the sensitivity of the stage changes, at one instant or gradually.

What you see
    Equal cycles before and after an instant have different heights and the same shape. Or each
    cycle is a little lower than the one before.
Why it happens
    A load was put on, a connector moved, a heater switched. A ceramic warms up or loses its
    poling.
How it is detected
    A step of the gain at one instant explains what static hysteresis with one gain for each
    recording cannot, better than a ramp or a temporary change at the same instant. If a drive
    repeats eight times or more, a gain that changes linearly over the recording is tried as
    well; with fewer cycles it would be confounded with creep or the initial state. Between
    recordings, all later recordings share one gain, if they are as fast as the earlier ones.
What the extension adds
    A gain that changes at an instant, or over a whole recording; the remedy is two models, one
    for each condition, or a sweep when the stage is warm.
Source
    spring load on a ceramic of finite stiffness, manufacturers' application notes
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from piezoid.diagnosis.blocked_regression import Null
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
from piezoid.diagnosis.signals import with_extension
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange, ramp
from piezoid.identification.hysteresis.cycles import MIN_CYCLES
from piezoid.numerics.arrays import Array
from piezoid.numerics.repetition import equal_cycles
from piezoid.records.recording import Recording

# Of the parts of a track, in shares of it, in each of which the best instant is tried. It has to
# be right: beside two other effects the gain on left-out blocks was 0.25 at the true instant and
# 0.005 at the best of 40 even ones.
EDGES = np.linspace(0.06, 0.94, 5)
MIN_CHANGE = 0.003  # of the gain: a step of the zero alone is another effect
MIN_CHANGE_BETWEEN = 0.005  # recordings of other drives differ by less if the class is inexact
EQUAL_SPEED = 4.0  # ratio of speeds between recordings within which a gain is no filter
MIN_RANGE = 0.25  # of the displacement in a track, over the largest
TEMPORARY = 0.2  # duration of a temporary change, of a track
# Of a track, from the ends of a temporary change to the best instant. With 0.02 the same 26 of 89
# stages of the zoo are recognised, with 0.1 one more, which has no gain change.
APART = 0.05


def _change(
    view: View, k: int, instant: float, duration: float, *, is_temporary: bool = False
) -> Array:
    """Return columns of a gain and a zero that change in one track, in shares of its duration."""
    track = view.tracks[k]
    time = track.rows / len(track.drive)
    share = ramp(time, instant, duration)
    if is_temporary:
        share = share - ramp(time, instant + TEMPORARY, duration)
    response = view.static[k][track.rows]
    return np.column_stack([view.track_column(k, share * response), view.track_column(k, share)])


def _trials(view: View) -> list[Trial]:
    """Return changes in each track that moves far enough; temporary changes are their placebos."""
    full_range = max(float(np.ptp(static)) for static in view.static)
    null = replace(view, selected=np.hstack([view.selected, _gains(view)])).null
    trials: list[Trial] = []
    for k, static in enumerate(view.static):
        if np.ptp(static) < MIN_RANGE * full_range:
            continue
        time, powers = _step_powers(view, null, k)
        for instant in _best_instants(time, powers):
            parameters = {"track": float(k), "place": instant}
            trials.append(_trial(_change(view, k, instant, 0.0), parameters, free={"place": 0.02}))
        best = time[np.argmax(powers)]
        _, powers = _step_powers(view, null, k, duration=TEMPORARY)
        # a temporary change at the true instant would explain the change itself
        powers[(np.abs(time - best) < APART) | (np.abs(time + TEMPORARY - best) < APART)] = 0.0
        placebos = [
            _change(view, k, instant, 0.0, is_temporary=True)
            for instant in _best_instants(time, powers)
        ]
        # enough equal cycles show a slow trend of the gain
        if equal_cycles(view.tracks[k].drive, fewest=MIN_CYCLES) is not None:
            trend = {"track": float(k), "place": 0.5, "lasts": 1.0}
            trials.append(_trial(_change(view, k, 0.5, 1.0), trend))
        else:
            placebos += [_change(view, k, instant, 0.5) for instant in EDGES]
        trials += [_trial(columns, {}, physical=False) for columns in placebos]
    return trials


def _gains(view: View) -> Array:
    """Return the columns of one constant gain for each track but the first."""
    later = list(enumerate(view.tracks))[1:]
    columns = [view.track_column(k, view.static[k][track.rows]) for k, track in later]
    return np.column_stack([np.zeros((len(view.response), 0)), *columns])


def _step_powers(view: View, null: Null, k: int, duration: float = 0.0) -> tuple[Array, Array]:
    """Return the rows of track k in shares of the track, and the power that a change explains.

    duration  of a temporary change, in shares of the track; 0: the change is permanent
    """
    track = view.tracks[k]
    time = track.rows / len(track.drive)
    rows = round(duration * len(time)) or None
    powers = null.step_powers(view.static[k][track.rows], view.track_rows(k), rows)
    return time, np.where((time >= EDGES[0]) & (time < EDGES[-1]), powers, 0.0)


def _best_instants(time: Array, powers: Array) -> list[float]:
    """Return the instant of the largest power between any two edges."""
    parts = [slice(*pair) for pair in pairwise(np.searchsorted(time, EDGES).tolist())]
    return [float(time[part][np.argmax(powers[part])]) for part in parts if powers[part].any()]


def _trial(
    columns: Array,
    parameters: Parameters,
    *,
    physical: bool = True,
    free: Parameters | None = None,
    min_change: float = MIN_CHANGE,
) -> Trial:
    return Trial(
        columns=columns,
        parameters=parameters,
        physical=physical,
        coefficient_range=(-0.3, 0.3),
        minimum_coefficient=min_change,
        free=free or {},
        limits={"place": (float(EDGES[0]), float(EDGES[-1]))} if free else {},
    )


def _from_track_on(view: View, first: int) -> Array:
    """Return the column of a gain of all tracks from ``first`` on."""
    return view.column(lambda k, _: view.static[k] * float(k >= first))[:, None]


def _trials_between(view: View) -> list[Trial]:
    """Return changes between two tracks, if tracks of similar speed are on both sides.

    Their placebo is a change in one track alone, undone before the next.
    """
    speed = [
        float(np.sqrt(np.mean(np.gradient(static) ** 2))) * track.rate_Hz
        for static, track in zip(view.static, view.tracks, strict=True)
    ]
    trials, placebos = [], []
    for k in range(1, len(speed)):
        column = _from_track_on(view, k)
        if any(a < EQUAL_SPEED * b and b < EQUAL_SPEED * a for a in speed[:k] for b in speed[k:]):
            change = {"track": float(k), "place": 0.0}
            trials.append(_trial(column, change, min_change=MIN_CHANGE_BETWEEN))
        if k < len(speed) - 1:
            temporary = column - _from_track_on(view, k + 1)
            placebos.append(
                _trial(
                    temporary,
                    {"track": 0.0, "place": 0.0},
                    physical=False,
                    min_change=MIN_CHANGE_BETWEEN,
                )
            )
    return [*trials, *placebos]


def _about_middle(recording: Recording) -> tuple[Array, Array]:
    voltage_V = recording.voltage_V()
    middle = voltage_V - 0.5 * (voltage_V.max() + voltage_V.min())
    return recording.time_s, np.asarray(np.sign(middle))


def inject(recording: Recording, share: float) -> Recording:
    """Let the gain rise in the middle, by twice its share at the end of the stroke."""
    middle_s, ratio = 0.5 * recording.duration_s, 1.0 + 4.0 * share
    change = GainChange(recording=recording.name, instant_s=middle_s, ratio=ratio)
    return with_extension(recording, change)


def extend(estimate: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search."""
    piece = setting.pieces[int(estimate.parameters["track"])]
    duration_s = piece.samples / piece.rate_Hz
    instant_s = piece.first / piece.rate_Hz + estimate.parameters["place"] * duration_s
    following = setting.recordings.index(piece.recording) + 1
    return (
        GainChange(
            recording=piece.recording,
            instant_s=instant_s,
            ratio=float(np.clip(1.0 + estimate.first_coefficient, 0.5, 2.0)),
            later=setting.recordings[following:],
            lasts_s=estimate.parameters.get("lasts", 0.0) * duration_s,
        ),
    )


WITHIN = Effect(
    name="gain_change",
    explanation=__doc__ or "",
    unit="%",
    experiment="Record equal full cycles for the whole time, and write down when anything on "
    "the stage is touched. A small multisine shows whether a load, which moves the resonance, "
    "is the cause.",
    control="The gain of the inverse is no longer right: fit again, or keep a margin for it.",
    shows=Appearance(
        label="time",
        unit="s",
        kind="time",
        along=_about_middle,
        reading="Multiplied by the side of the range. A gain change: a permanent step, or a "
        "slope from end to end.",
    ),
    tangent=Tangent(
        advised=("equal_cycles",),
        columns=lambda drive, _: np.asarray(
            (drive.static_m * (drive.time_s > 0.5 * drive.time_s[-1]))[:, None]
        ),
        per_drive=True,
    ),
    confounded=("creep", "thermal_drift"),
    trials=_trials,
    columns=lambda view, parameters: _change(
        view, int(parameters["track"]), parameters["place"], parameters.get("lasts", 0.0)
    ),
    covariates=_gains,
    size=lambda _, __, coefficient: 100.0 * float(coefficient[0]),
    model_error=0.03,  # hysteresis absorbs a part of a step of the gain
    inject=inject,
    extend=extend,
    without=without_part(GainChange),
    detectable_share=8e-3,
    minimum_gain=0.1,  # a small error of the initial state also changes the heights of cycles
)
BETWEEN = replace(
    WITHIN,
    trials=_trials_between,
    columns=lambda view, parameters: _from_track_on(view, int(parameters["track"])),
    covariates=None,
)
EFFECT = replace(WITHIN, between_recordings=BETWEEN)
