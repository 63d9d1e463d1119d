"""Resonance: the stage is a mass on a spring.

What you see
    Ringing after corners of the drive; motion is amplified near one frequency.
Why it happens
    Flexures and ceramic are springs, stage and sample are masses, and the damping is small.
How it is detected
    The static response behind one mode explains what static hysteresis cannot, with a positive
    share of at most the whole, a damping well below one and a frequency inside the band searched.
What the extension adds
    One mode in parallel with the direct response; with a share of one, the mode carries all of it.
    Where a recording has fewer than ten samples in a period of the mode, rows behind a step of the
    drive count only after the ringing: its phase depends on the instant of the step.
Source
    Devasia, Eleftheriou & Moheimani (2007); Fleming & Leang (2014)
"""

import numpy as np

from piezoid.diagnosis.appearance import IN_SPECTRUM
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
from piezoid.diagnosis.refitted_view import with_polynomial_response
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import filtered_change, mode, through
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.linear_mode import LinearMode, StruckMode
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording

ALLOWED = (0.01, 1.6)
QUALITIES = (4.0, 12.0, 40.0)
SHARP = (20.0, 60.0)  # of the modes to try about the best one of the grid,
APART = 0.5  # of their width,
TELLING = 0.02  # smallest share of the squared residual
DAMPED = (2.5, 300.0)  # quality factors: below a lag, above not measurable
LOWEST_Hz = 15.0
INJECTED_Hz = 300.0
PER_OCTAVE = 5
LEAST_RATE_Hz = 200.0
PLANNED_QUALITY = 20.0


def _untestable(view: View) -> str:
    fastest_Hz = max(track.rate_Hz for track in view.tracks)
    if fastest_Hz < LEAST_RATE_Hz:
        return f"the fastest recording has {fastest_Hz:.4g} Hz; modes lie above {LOWEST_Hz:g} Hz"
    return ""


def _rung(response: Array, rate_Hz: float, parameters: Parameters) -> Array:
    return mode(response, parameters["frequency_Hz"], parameters["quality"], rate_Hz)


def _columns(view: View, parameters: Parameters) -> Array:
    return filtered_change(view, _rung, parameters)


def _trials(view: View) -> list[Trial]:
    highest_Hz = 0.24 * max(track.rate_Hz for track in view.tracks)
    count = int(PER_OCTAVE * np.log2(highest_Hz / LOWEST_Hz)) + 1
    ways = [
        {"frequency_Hz": float(f), "quality": q}
        for f in np.geomspace(LOWEST_Hz, highest_Hz, count)
        for q in QUALITIES
    ]
    trials = [_trial(view, mode, highest_Hz) for mode in ways]
    best, share = _best(view, trials)
    if share < TELLING:
        return trials
    smooth = with_polynomial_response(view)
    return trials + [_trial(smooth, mode, highest_Hz) for mode in _closer(best.parameters)]


def _trial(view: View, mode: Parameters, highest_Hz: float) -> Trial:
    return Trial(
        columns=_columns(view, mode),
        parameters=mode,
        coefficient_range=ALLOWED,
        free={"frequency_Hz": 1.06, "quality": 1.6},
        limits={"quality": DAMPED, "frequency_Hz": (LOWEST_Hz, highest_Hz)},
    )


def _best(view: View, trials: list[Trial]) -> tuple[Trial, float]:
    """Return the trial that explains most of the squared residual, and its share."""
    across = view.null.without(np.hstack([trial.columns for trial in trials]))
    residual = view.null.residual
    square = np.einsum("ij,ij->j", across, across) + 1e-300
    shares = (across.T @ residual) ** 2 / square / float(residual @ residual)
    k = int(np.argmax(shares))
    return trials[k], float(shares[k])


def _closer(best: Parameters) -> list[dict[str, float]]:
    """Return a finer grid of modes about the best one.

    A sharp mode between two of the grid shows a shoulder there, and a search by steps from it ends
    at a blunter one beside it.
    """
    reach = 2.0 ** (1.0 / PER_OCTAVE)
    return [
        {"frequency_Hz": best["frequency_Hz"] * float(ratio), "quality": quality}
        for quality in SHARP
        for ratio in np.geomspace(
            1.0 / reach, reach, int(2.0 * np.log(reach) * quality / APART) + 1
        )
    ]


def _tangent(drive: Driven, frequency_Hz: float) -> Array:
    rung_m = mode(drive.static_m, frequency_Hz, PLANNED_QUALITY, drive.rate_Hz)
    return (rung_m - drive.static_m)[:, None]


def inject(recording: Recording, share: float) -> Recording:
    """Let a part of the motion ring, fifty times the share: so much of it a chirp shows."""
    frequency_Hz = min(INJECTED_Hz, 0.2 * recording.sampling_rate_Hz)
    participation = min(50.0 * share, 1.0)
    ringing = LinearMode(frequency_Hz=frequency_Hz, quality=15.0, participation=participation)
    return through(recording, ringing)


def extend(estimate: EffectEstimate, _: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search."""
    # after a jump it has two columns, one sample apart: their sum is the mode
    kind, share = (
        (StruckMode, float(np.sum(estimate.coefficient)))
        if estimate.from_jumps
        else (LinearMode, estimate.first_coefficient)
    )
    mode = kind(
        frequency_Hz=estimate.parameters["frequency_Hz"],
        quality=max(estimate.parameters["quality"], 0.5),
        participation=float(np.clip(share, 0.0, 2.0)),
    )
    return (mode,)


EFFECT = Effect(
    name="resonance",
    explanation=__doc__ or "",
    unit="Hz",
    model_error=0.002,
    experiment="Record small chirps of three amplitudes through the suspected mode, at the rate "
    "of the controller or faster.",
    control="The resonance limits the bandwidth: use a notch or a limit on the sensitivity "
    "there, and round the corners of triangles.",
    shows=IN_SPECTRUM,
    tangent=Tangent(columns=_tangent, lags=True, scale=500.0, scale_parameter="frequency_Hz"),
    confounded=("delay", "lag"),
    untestable=_untestable,
    trials=_trials,
    columns=_columns,
    size=lambda _, parameters, __: parameters["frequency_Hz"],
    may_be_absorbed=True,
    inject=inject,
    extend=extend,
    without=without_part(LinearMode),
)
