"""Quantisation: a converter with too few bits or too wide a range.

    y = q round(x / q)

Source: Widrow & Kollar, Quantization Noise (2008): the error of a busy signal has rms
q / sqrt(12).
"""

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import (
    Act,
    Bench,
    Effect,
    Fault,
    Measure,
    Place,
)


def install(size_m: float, _bench: Bench, _: np.random.Generator) -> Fault:
    """Set the step from the rms of its rounding error."""
    step_m = float(np.sqrt(12.0)) * size_m
    act = Act(
        name=EFFECT.name,
        place=Place.CONVERTER,
        change=lambda sampled_m, _scene, _: step_m * np.round(sampled_m / step_m),
    )
    return Fault(acts=(act,), numbers={"step_m": step_m})


EFFECT = Effect(
    name="quantisation",
    measure=Measure.RMS,
    visible_percent=0.08,
    shown_by=("sweep",),
    install=install,
)
