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

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from piezoid.diagnosis.appearance import Appearance
from piezoid.diagnosis.drive_response import Driven
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
from piezoid.diagnosis.segments import Track
from piezoid.diagnosis.signals import seconds_of, through
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.gain_change import GainChange, turned
from piezoid.identification.hysteresis.cycles import FEWEST
from piezoid.numerics.arrays import Array
from piezoid.numerics.repetition import equal_cycles
from piezoid.records.recording import Recording

PLACES = np.linspace(0.07, 0.93, 13)
LEAST_CHANGE = 0.003  # of the gain: a step of the zero alone is something else
LEAST_BETWEEN = 0.005  # recordings of other drives differ by less where a class does not quite fit
ALIKE = 4.0  # ratio of speeds between recordings that tell a gain from a filter
NARROW = 0.2  # of the track: how long a passing change lasts


def _change(view: View, k: int, place: float, lasts: float, *, passes: bool = False) -> Array:
    """Return the change in one track, and of its zero; times are shares of the track."""
    track = view.tracks[k]
    time = track.place / len(track.drive)
    share = turned(time, place, lasts)
    if passes:
        share = share - turned(time, place + NARROW, lasts)
    response = view.static[k][track.place]
    return np.column_stack([view.of_track(k, share * response), view.of_track(k, share)])


def _beside(view: View) -> Array:
    """Return what all tracks but the first may differ by: no evidence of an instant."""
    columns = [
        view.of_track(n, static[track.place])
        for n, (track, static) in enumerate(zip(view.tracks, view.static, strict=True))
        if n > 0
    ]
    return np.column_stack([np.zeros((len(view.offset), 0)), *columns])


def _trials(view: View) -> list[Trial]:
    own = 1.5 * max(float(np.ptp(static)) for static in view.static) / 2
    found: list[Trial] = []
    for k, static in enumerate(view.static):
        if np.ptp(static) < own / 3:
            continue
        steps = [_change(view, k, place, 0.0) for place in PLACES]
        found += [
            _trial(column, {"track": float(k), "place": float(place)}, free={"place": 0.02})
            for place, column in zip(PLACES, steps, strict=True)
        ]
        rivals = [_change(view, k, p - NARROW / 2, 0.0, passes=True) for p in PLACES[::3]]
        # enough equal cycles show a slow trend of the gain
        if equal_cycles(view.tracks[k].drive, fewest=FEWEST) is not None:
            slow = {"track": float(k), "place": 0.5, "lasts": 1.0}
            found.append(_trial(_change(view, k, 0.5, 1.0), slow))
        else:
            rivals += [_change(view, k, place, 0.5) for place in PLACES[::3]]
        found += [_trial(column, {}, physical=False) for column in rivals]
    return found


def _trial(
    columns: Array,
    parameters: Parameters,
    *,
    physical: bool = True,
    free: Parameters | None = None,
    least: float = LEAST_CHANGE,
) -> Trial:
    return Trial(
        columns=columns,
        parameters=parameters,
        physical=physical,
        coefficient_range=(-0.3, 0.3),
        minimum_coefficient=least,
        free=free or {},
    )


def _later(view: View, first: int) -> Array:
    """Return what a gain of all recordings from one on adds."""
    parts = [
        static[track.place] * float(k >= first)
        for k, (track, static) in enumerate(zip(view.tracks, view.static, strict=True))
    ]
    return np.concatenate(parts)[:, None]


def _steps_between(view: View) -> list[Trial]:
    """Return changes between two recordings, where others as fast were made on the other side.

    A change in one recording alone, undone before the next, is their placebo.
    """
    speed = [float(np.sqrt(np.mean(np.gradient(s) ** 2))) * t.rate_Hz for s, t in _read(view)]
    count = len(speed)
    found = [
        _between(k, _later(view, k)) for k in range(1, count) if _matched(speed[:k], speed[k:])
    ]
    alone = [_later(view, k) - _later(view, k + 1) for k in range(1, count - 1)]
    return [*found, *(_between(0, column, real=False) for column in alone)]


def _read(view: View) -> list[tuple[Array, Track]]:
    return list(zip(view.static, view.tracks, strict=True))


def _matched(before: Sequence[float], after: Sequence[float]) -> bool:
    return any(a < ALIKE * b and b < ALIKE * a for a in before for b in after)


def _between(first: int, columns: Array, *, real: bool = True) -> Trial:
    where = {"track": float(first), "place": 0.0}
    return _trial(columns, where, physical=real, least=LEAST_BETWEEN)


def _columns(view: View, parameters: Parameters) -> Array:
    track, lasts = int(parameters["track"]), parameters.get("lasts", 0.0)
    return _change(view, track, parameters["place"], lasts)


def _tangent(drive: Driven, _: float) -> Array:
    after = drive.time_s > 0.5 * drive.time_s[-1]
    return np.asarray((drive.static_m * after)[:, None])


def _about_middle(recording: Recording) -> tuple[Array, Array]:
    voltage_V = recording.voltage_V()
    middle = voltage_V - 0.5 * (voltage_V.max() + voltage_V.min())
    return seconds_of(recording), np.asarray(np.sign(middle))


def inject(recording: Recording, share: float) -> Recording:
    """Let the gain rise in the middle, by twice its share at the end of the stroke."""
    middle_s, ratio = 0.5 * recording.duration_s, 1.0 + 4.0 * share
    change = GainChange(recording=recording.name, instant_s=middle_s, ratio=ratio)
    return through(recording, change)


def extend(found: EffectEstimate, setting: SearchScaling) -> tuple[Extension, ...]:
    """Return the part of the model that begins where a search found it."""
    piece = setting.pieces[int(found.parameters["track"])]
    whole_s = piece.samples / piece.rate_Hz
    instant_s = piece.first / piece.rate_Hz + found.parameters["place"] * whole_s
    after = setting.recordings.index(piece.recording) + 1
    return (
        GainChange(
            recording=piece.recording,
            instant_s=instant_s,
            ratio=float(np.clip(1.0 + found.first_coefficient, 0.5, 2.0)),
            later=setting.recordings[after:],
            lasts_s=found.parameters.get("lasts", 0.0) * whole_s,
        ),
    )


WITHIN = Effect(
    name="gain_change",
    explanation=__doc__ or "",
    unit="percent",
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
    tangent=Tangent(columns=_tangent, own=True),
    confounded=("creep", "thermal_drift"),
    trials=_trials,
    columns=_columns,
    covariates=_beside,
    size=lambda _, __, coefficient: 100.0 * float(coefficient[0]),
    model_error=0.03,  # the hysteresis beside it takes a part of a step of the gain
    inject=inject,
    extend=extend,
    without=without_part(GainChange),
    detectable_share=8e-3,
    minimum_gain=0.1,  # a memory that is not quite known bends the heights of cycles as well
)
BETWEEN = replace(
    WITHIN,
    trials=_steps_between,
    columns=lambda view, parameters: _later(view, int(parameters["track"])),
    covariates=None,
)
EFFECT = replace(WITHIN, between_recordings=BETWEEN)
