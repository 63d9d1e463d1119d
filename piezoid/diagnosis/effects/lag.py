"""Lag: a first-order filter that was not declared.

What you see
    Loops open with the speed of the drive, and fast motion is attenuated.
Why it happens
    A filter of the sensor, a servo of low bandwidth or a demodulator. Or an amplifier that
    charges the ceramic slowly; the hysteresis then follows the filtered command.
How it is detected
    The static response behind one pole explains what static hysteresis cannot, with nearly all
    of the response passing through it. At low frequency a lag cannot be told from a delay, and
    the report says so. The pole is placed in front of the hysteresis if the error is clearly
    smaller there.
What the extension adds
    A first-order pole behind or in front of the hysteresis.
Source
    Fleming & Leang (2014)
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.appearance import OVER_SPEED
from piezoid.diagnosis.effect import Effect, Parameters, Trial, delay_tangent, without_part
from piezoid.diagnosis.residual_view import View
from piezoid.diagnosis.signals import filtered_change, through
from piezoid.identification.extensions.first_order_lag import FirstOrderLag
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed

SHORTEST = 0.5  # samples of the fastest recording
LONGEST_s = 0.1
TRIED = 14
# strokes a second at which what is injected is late by its share: the same pole in every recording
SPEED = 50.0


def _passed(response: Array, rate_Hz: float, parameters: Parameters) -> Array:
    return relaxed(response, parameters["time_s"], rate_Hz)


def _trials(view: View) -> list[Trial]:
    fastest_Hz = max(track.rate_Hz for track in view.tracks)
    times_s = np.geomspace(SHORTEST / fastest_Hz, LONGEST_s, TRIED)
    return [
        Trial(
            columns=filtered_change(view, _passed, {"time_s": float(t)}),
            parameters={"time_s": float(t)},
            needs_time=True,
            free={"time_s": 1.5},
        )
        for t in times_s
    ]


BEHIND = Effect(
    name="lag",
    explanation=__doc__ or "",
    unit="µs",
    model_error=0.015,
    experiment="Record a small multisine or chirp beyond the corner 1/(2 pi lag): a lag "
    "attenuates there, a delay does not.",
    control="A lag costs phase and gain. Declare the filter in lab.toml or keep it in the "
    "model; otherwise the loop is designed for the wrong plant.",
    shows=OVER_SPEED,
    tangent=delay_tangent(_passed, "time_s"),
    confounded=("delay", "rate_dependence", "resonance"),
    trials=_trials,
    response_filter=_passed,
    size=lambda _, parameters, __: 1e6 * parameters["time_s"],
    inject=lambda recording, share: through(recording, FirstOrderLag(lag_s=share / SPEED)),
    extend=lambda estimate, _: (FirstOrderLag(lag_s=max(estimate.parameters["time_s"], 0.0)),),
    without=without_part(FirstOrderLag, lag=True),
)
IN_FRONT = replace(BEHIND, response_filter=None, drive_filter=_passed, other_side=BEHIND)
EFFECT = replace(BEHIND, other_side=IN_FRONT)
