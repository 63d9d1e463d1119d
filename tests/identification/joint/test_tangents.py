"""The columns of the joint fit are the derivatives of what it simulates."""

import numpy as np
import pytest

from piezoid.identification.extensions import (
    AmplifierLimits,
    CrossAxis,
    Delay,
    FirstOrderLag,
    GainChange,
)
from piezoid.identification.extensions.extension import Extension
from piezoid.identification.joint.fit_extended import tangents_of
from piezoid.identification.joint.vector import Part, State, Structure, parts_of, state_of
from piezoid.numerics.arrays import Array
from tests.identification.joint.stage import known_model, recordings_of

STEP = 1e-6  # of numbers that are of order one
EXACT = 1e-6  # of a column's norm: what differences by such a step leave
NEAR = 0.15  # where a filter is taken for a delay, of columns that jump
CHANGE = GainChange(recording="slow.csv", instant_s=12.0, ratio=1.02, later=("fast.csv",))
ANSWER = CrossAxis(axis="y", centre_V=5.0, gain_m_per_V=2e-8, curvature_m_per_V_per_V=1e-9)


def differences(state: State, index: int, part: Part) -> Array:
    """The same columns, number by number, from the simulation alone."""
    found = np.empty((len(part.samples), len(state.theta)))
    for place in range(len(state.theta)):
        step = np.zeros(len(state.vector))
        step[place] = STEP
        ahead, back = (state.at(state.vector + s * step).run(index, part) for s in (1, -1))
        found[:, place] = (ahead.reading - back.reading)[part.samples] / (2.0 * STEP)
    return found


@pytest.mark.parametrize(
    ("extensions", "within"),
    [
        ((), EXACT),
        ((Delay(delay_samples=2.4),), EXACT),
        ((CHANGE,), EXACT),
        ((Delay(delay_samples=0.3), ANSWER), EXACT),
        ((AmplifierLimits(high_V=9.6), Delay(delay_s=3e-4)), EXACT),
        ((FirstOrderLag(lag_s=1e-3),), NEAR),
    ],
)
def test_every_column_of_the_hysteresis_is_the_derivative_of_the_reading(
    extensions: tuple[Extension, ...], within: float
) -> None:
    model = known_model()
    parts = parts_of(model, recordings_of(*extensions))
    state = state_of(model, parts, extensions, Structure(lag=False))
    for index, part in enumerate(parts):
        found = tangents_of(state, index, part, state.run(index, part))
        numeric = differences(state, index, part)
        apart = np.linalg.norm(found[:, : len(state.theta)] - numeric, axis=0)
        assert (apart <= within * np.linalg.norm(numeric, axis=0)).all()
