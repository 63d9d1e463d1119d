"""Creep: the stage goes on moving for minutes after the drive has stopped.

What you see
    During a hold the displacement goes on in the direction of the last step, by about as much in
    every decade of time; repeated loops close late.
Why it happens
    Domains climb barriers of widely spread heights: relaxation times are spread evenly over the
    logarithm of time.
How it is detected
    The static response behind lags of log-spaced time constants explains what static hysteresis
    cannot, with the sign of the drive, better than the same relaxation run backwards in time.
    Barriers are spread nearly evenly: of spectra that rise or fall a little with the logarithm of
    time, and begin with the whole or half of the fastest rung, the one that explains most,

        c(t) = a integral (1 + b log10(tau / 10 s)) h_tau(t) d log10 tau,

    h the static response. The size is a, what a step adds in the decade about ten seconds.
What the extension adds
    A ladder of relaxations behind the hysteresis, equal shares for each decade.
Source
    Jung & Gweon (2000); Kuhnen & Krejci (2009); Vieira (1986)
"""

from itertools import product

import numpy as np

from piezoid.diagnosis.effect import Effect, Found, Parameters, Setting, Trial
from piezoid.diagnosis.signals import scaled_to, seconds_of, with_displacement
from piezoid.diagnosis.view import View
from piezoid.identification.extensions.creep_ladder import CreepLadder
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.hysteresis.filters import first_order
from piezoid.numerics.arrays import Array
from piezoid.operators.ladder import ladder
from piezoid.records.recording import Recording

RUNGS = 8  # of a creep ladder in the model: as many as the runtime has
PER_DECADE = 2
FASTEST_s = 0.01
DECAY_s = 30.0  # of what began before a track: the rest of it is in its zero
LONGER = 10.0  # slowest time constant over the longest track
TOLD_AT_s = 10.0  # where the spectrum is told, within a record
TILTS = (0.0, -0.15, 0.15)  # of it there, for each decade
BEGINS = (1.0, 0.5)  # part of the fastest rung
ALLOWED = (0.0, 0.1)  # share of a step for each decade
LEAST_s = 2.0  # a shorter record shows no slow motion


def _untestable(view: View) -> str:
    longest_s = _longest_s(view)
    if longest_s < LEAST_s:
        return f"the longest recording lasts {longest_s:.2g} s; creep needs {LEAST_s:g} s or more"
    return ""


def _longest_s(view: View) -> float:
    return max(track.duration_s for track in view.tracks)


def _ladder(view: View, parameters: Parameters, *, backwards: bool = False) -> Array:
    """Return the relaxation of the static response that adds a whole step in a decade."""
    first, last = np.log10([FASTEST_s, LONGER * _longest_s(view)])
    decade = np.arange(first + 0.5 / PER_DECADE, last, 1.0 / PER_DECADE)
    share = 1.0 + parameters["tilt"] * (decade - np.log10(min(TOLD_AT_s, _longest_s(view))))
    share[0] *= parameters["begins"]
    times_s, share = (10.0**decade).tolist(), np.maximum(share, 0.0) / PER_DECADE

    def crept(signal: Array, rate_Hz: float) -> Array:
        rungs = [first_order(time_s, rate_Hz) for time_s in times_s]
        total = ladder(signal[::-1] if backwards else signal, rungs, share)
        return total[::-1] if backwards else total

    return view.of(lambda k, track: crept(view.static[k], track.rate_Hz))[:, None]


def _trials(view: View) -> list[Trial]:
    found = []
    for tilt, begins, backwards in product(TILTS, BEGINS, (False, True)):
        spectrum = {"tilt": tilt, "begins": begins}
        found.append(
            Trial(
                columns=_ladder(view, spectrum, backwards=backwards),
                parameters=spectrum,
                physical=not backwards,
                coefficient_range=ALLOWED,
            )
        )
    return found


def _decays(view: View) -> Array:
    """Return each track's own return to rest: creep that began before it did."""
    return np.column_stack(
        [
            view.of_track(k, np.exp(-track.place / (track.rate_Hz * DECAY_s)))
            for k, track in enumerate(view.tracks)
        ]
    )


def _columns(view: View, parameters: Parameters) -> Array:
    return _ladder(view, parameters)


def _size(_: View, __: Parameters, coefficient: Array) -> float:
    return 100.0 * float(coefficient[0])


def inject(recording: Recording, share: float) -> Recording:
    """Let a recording creep."""
    moved_m, rate_Hz = recording.displacement_m(), recording.sampling_rate_Hz
    times_s = np.geomspace(0.03, 3.0 * float(seconds_of(recording)[-1]) + 0.1, 9)
    crept_m = ladder(moved_m, [first_order(time_s, rate_Hz) for time_s in times_s])
    return with_displacement(
        recording, moved_m + scaled_to(crept_m - crept_m.mean(), share, recording)
    )


def extend(found: Found, setting: Setting) -> tuple[Extension, ...]:
    """Return the part of the model that begins with the share that a search found."""
    time_s = np.geomspace(FASTEST_s, LONGER * setting.longest_s, RUNGS)
    share = np.clip(found.share * np.log10(time_s[1] / time_s[0]), 1e-4, 0.1)
    return (CreepLadder(time_s=tuple(time_s.tolist()), share=(float(share),) * RUNGS, even=True),)


EFFECT = Effect(
    name="creep",
    explanation=__doc__ or "",
    unit="percent of a step per decade of time",
    # on 25 stages of thirteen laws: 14 % rms
    model_error=0.15,
    experiment="Record a staircase of random levels, up and down, each held for ten seconds or "
    "more, and the same staircase mirrored: creep changes sign with the steps, drift does not.",
    confounded=("thermal_drift",),
    untestable=_untestable,
    trials=_trials,
    covariates=_decays,
    columns=_columns,
    size=_size,
    inject=inject,
    extend=extend,
)
