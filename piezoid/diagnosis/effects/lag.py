"""Lag: a first-order filter that was not declared.

What you see
    Loops open with the speed of the drive, and fast motion is attenuated.
Why it happens
    A filter of the sensor, a servo of low bandwidth or a demodulator. Or an amplifier that
    charges the ceramic slowly; the hysteresis then follows the filtered command.
How it is detected
    The static response behind one pole explains what static hysteresis cannot, with nearly all
    of the response passing through it. At low frequency a lag cannot be separated from a delay,
    and the report states it. The pole is placed in front of the hysteresis if the error is clearly
    smaller there.
What the extension adds
    A first-order pole behind or in front of the hysteresis.
Source
    Fleming & Leang (2014)
"""

from dataclasses import replace

import numpy as np

from piezoid.diagnosis.effect import OVER_SPEED, Effect, Parameters, delay_tangent, without_part
from piezoid.diagnosis.signals import delay_trials, trial_times_s, with_extension
from piezoid.formatting import with_unit
from piezoid.identification.extensions.lags import FirstOrderLag
from piezoid.numerics.arrays import Array
from piezoid.operators.filters import relaxed

LONGEST_s = 0.1
TRIALS = 14
SPEED = 50.0  # strokes per second at which the error of the injected lag is its share


def _lagged(response: Array, rate_Hz: float, parameters: Parameters) -> Array:
    return relaxed(response, parameters["time_s"], rate_Hz)


BEHIND = Effect(
    name="lag",
    explanation=__doc__ or "",
    unit="µs",
    model_error=0.015,
    experiment="Record a small multisine or chirp beyond the corner of the lag: a lag attenuates "
    "there, a delay does not.",
    control="A lag costs phase and gain. Declare the filter in lab.toml or keep it in the "
    "model; otherwise the loop is designed for the wrong plant.",
    shows=OVER_SPEED,
    tangent=delay_tangent(_lagged, "time_s"),
    confounded=("delay", "rate_dependence", "resonance"),
    may_be_loop_shape=True,
    trials=lambda view: delay_trials(
        view, _lagged, [("time_s", time_s) for time_s in trial_times_s(view, LONGEST_s, TRIALS)]
    ),
    response_filter=_lagged,
    size=lambda _, parameters, __: 1e6 * parameters["time_s"],
    note=lambda parameters: (
        f"Its corner is at {with_unit(1.0 / (2.0 * np.pi * parameters['time_s']), 'Hz')}."
    ),
    inject=lambda recording, share: with_extension(recording, FirstOrderLag(lag_s=share / SPEED)),
    extend=lambda estimate, _: (FirstOrderLag(lag_s=max(estimate.parameters["time_s"], 0.0)),),
    without=without_part(FirstOrderLag, lag=True),
)
IN_FRONT = replace(BEHIND, response_filter=None, drive_filter=_lagged, other_side=BEHIND)
EFFECT = replace(BEHIND, other_side=IN_FRONT)
