"""Delay: the reading comes late, by the same time at every frequency.

What you see
    Loops open with the speed of the drive, large and small ones alike; nothing is attenuated.
Why it happens
    Converters, digital filters and cables deliver a value some time after it was measured.
How it is detected
    The delayed static response explains what static hysteresis cannot. A delay of the same time
    and a delay of the same number of samples in all recordings are both tried.
What the extension adds
    A pure delay behind the hysteresis.
Source
    Devasia, Eleftheriou & Moheimani (2007)
"""

from piezoid.diagnosis.effect import (
    OVER_SPEED,
    Effect,
    EffectEstimate,
    Parameters,
    SearchScaling,
    Trial,
    delay_tangent,
    without_part,
)
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import delay_trials, trial_times_s, with_extension
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.extensions.lags import Delay
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import later

LONGEST_s = 0.03
TRIALS = 12
SPEED = 50.0  # strokes per second at which the error of the injected delay is its share


def _delayed(response: Array, rate_Hz: float, parameters: Parameters) -> Array:
    time_s = parameters.get("delay_s", 0.0) + parameters.get("delay_samples", 0.0) / rate_Hz
    return later(response, time_s * rate_Hz)


def _trials(view: View) -> list[Trial]:
    delays = [("delay_s", time_s) for time_s in trial_times_s(view, LONGEST_s, TRIALS)]
    if len({track.rate_Hz for track in view.tracks}) > 1:
        delays += [("delay_samples", samples) for samples in (1.0, 2.0, 4.0, 8.0)]
    return delay_trials(view, _delayed, delays)


def extend(estimate: EffectEstimate, _: SearchScaling) -> tuple[Extension, ...]:
    """Return the model extension, starting from the estimate of the search."""
    samples = estimate.parameters.get("delay_samples", 0.0)
    if samples > 0.0:
        return (Delay(delay_samples=samples),)
    return (Delay(delay_s=max(estimate.parameters.get("delay_s", 0.0), 0.0)),)


EFFECT = Effect(
    name="delay",
    explanation=__doc__ or "",
    unit="µs, in the fastest recording",
    model_error=0.004,
    experiment="Record a small multisine or chirp to a third of the resonance or beyond: a delay "
    "turns the phase in proportion to frequency and leaves the gain flat, a lag attenuates.",
    control="A delay costs phase in proportion to frequency and limits the bandwidth; the "
    "reference can be advanced by a constant delay.",
    shows=OVER_SPEED,
    tangent=delay_tangent(_delayed, "delay_s"),
    confounded=("lag", "rate_dependence", "resonance"),
    trials=_trials,
    response_filter=_delayed,
    size=lambda view, parameters, _: (
        1e6
        * (parameters.get("delay_s", 0.0) + parameters.get("delay_samples", 0.0) / view.fastest_Hz)
    ),
    inject=lambda recording, share: with_extension(recording, Delay(delay_s=share / SPEED)),
    extend=extend,
    without=without_part(Delay, lag=True),
)
