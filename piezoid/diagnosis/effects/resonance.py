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

from piezoid.diagnosis.effect import (
    IN_SPECTRUM,
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Tangent,
    Trial,
    without_part,
)
from piezoid.diagnosis.refinement import with_polynomial_response
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import filtered_change, mode, with_extension
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.linear_mode import FixedMode, LinearMode
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import each_column
from piezoid.records.recording import Recording

SHARES = (0.01, 1.6)  # physically possible coefficients
QUALITIES = (4.0, 12.0, 40.0)
FINE_QUALITIES = (20.0, 60.0)  # of the finer grid of modes about the best mode of the first grid
FINE_STEP = 0.5  # between frequencies of the finer grid, of the width of a mode
MIN_POWER_SHARE = 0.02  # of the squared residual, by a mode about which a finer grid is tried
QUALITY_RANGE = (2.5, 300.0)  # a mode below it is a lag, a mode above it not measurable
LOWEST_Hz = 15.0
INJECTED_Hz = 300.0
PER_OCTAVE = 5
MIN_RATE_Hz = 200.0
PLANNED_QUALITY = 20.0


def _mode(signal: Array, rate_Hz: float, parameters: Parameters) -> Array:
    frequency_Hz, quality = parameters["frequency_Hz"], parameters["quality"]
    return each_column(lambda column: mode(column, frequency_Hz, quality, rate_Hz), signal)


def _columns(view: View, parameters: Parameters) -> Array:
    return filtered_change(view, _mode, parameters)


def _trials(view: View) -> list[Trial]:
    """Return a grid of modes, and a finer grid about the mode that explains most.

    A sharp mode between two frequencies of the first grid explains little at both, and a search by
    steps from there ends at a mode that is damped too much.
    """
    highest_Hz = 0.24 * view.fastest_Hz
    count = int(PER_OCTAVE * np.log2(highest_Hz / LOWEST_Hz)) + 1
    trials = [
        _trial(view, {"frequency_Hz": frequency_Hz, "quality": quality}, highest_Hz)
        for frequency_Hz in np.geomspace(LOWEST_Hz, highest_Hz, count).tolist()
        for quality in QUALITIES
    ]
    orthogonal = view.null.project_out(np.hstack([trial.columns for trial in trials]))
    residual = view.null.residual
    square = np.einsum("ij,ij->j", orthogonal, orthogonal) + 1e-300
    shares = (orthogonal.T @ residual) ** 2 / square / float(residual @ residual)
    best = int(np.argmax(shares))
    if float(shares[best]) < MIN_POWER_SHARE:
        return trials
    best_Hz, reach = trials[best].parameters["frequency_Hz"], 2.0 ** (1.0 / PER_OCTAVE)
    smooth = with_polynomial_response(view)
    for quality in FINE_QUALITIES:
        count = int(2.0 * np.log(reach) * quality / FINE_STEP) + 1
        for ratio in np.geomspace(1.0 / reach, reach, count).tolist():
            parameters = {"frequency_Hz": best_Hz * ratio, "quality": quality}
            trials.append(_trial(smooth, parameters, highest_Hz))
    return trials


def _trial(view: View, mode: Parameters, highest_Hz: float) -> Trial:
    return Trial(
        columns=_columns(view, mode),
        parameters=mode,
        coefficient_range=SHARES,
        free={"frequency_Hz": 1.06, "quality": 1.6},
        limits={"quality": QUALITY_RANGE, "frequency_Hz": (LOWEST_Hz, highest_Hz)},
    )


def inject(recording: Recording, share: float) -> Recording:
    """Let fifty times the share of the motion ring: a chirp shows a fiftieth of it."""
    frequency_Hz = min(INJECTED_Hz, 0.2 * recording.sampling_rate_Hz)
    participation = min(50.0 * share, 1.0)
    ringing = LinearMode(frequency_Hz=frequency_Hz, quality=15.0, participation=participation)
    return with_extension(recording, ringing)


def extend(estimate: EffectEstimate, _: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search."""
    # after a step of the drive the mode is the sum of two columns that are one sample apart
    kind, share = (
        (FixedMode, float(np.sum(estimate.coefficient)))
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
    tangent=Tangent(
        columns=lambda drive, frequency_Hz: (
            mode(drive.static_m, frequency_Hz, PLANNED_QUALITY, drive.rate_Hz) - drive.static_m
        )[:, None],
        lags=True,
        scale=500.0,
        scale_parameter="frequency_Hz",
    ),
    confounded=("delay", "lag"),
    untestable=lambda view: (
        ""
        if view.fastest_Hz >= MIN_RATE_Hz
        else f"the fastest recording has {view.fastest_Hz:.4g} Hz; modes lie above "
        f"{LOWEST_Hz:g} Hz"
    ),
    trials=_trials,
    columns=_columns,
    mode_filter=_mode,
    size=lambda _, parameters, __: parameters["frequency_Hz"],
    may_be_absorbed=True,
    inject=inject,
    extend=extend,
    without=without_part(LinearMode),
)
