"""Derivatives of the reading by all numbers, at the rows that count.

The columns of the hysteresis pass what follows within samples (delays, lags, modes) exactly where
that matters; where motion is slow, the filters are a delay and two rows are enough for each that
counts. Creep is left out of them: it is a part in a hundred of a column, and the search is judged
by the true error anyway. What extensions add enters exactly, their other numbers by differences.
"""

import numpy as np

from piezoid.identification.extensions.extension import Samples
from piezoid.identification.joint.chain import (
    Followed,
    follow,
    late_s,
    passed,
)
from piezoid.identification.joint.parts import Part
from piezoid.identification.joint.vector import State
from piezoid.numerics.arrays import Array
from piezoid.operators.chain import Chain, Following
from piezoid.operators.dead_zone import from_slopes

SLOW = 0.004  # of the motion: what a delay may miss of the filters
LARGEST = 16_000_000  # numbers in one array of columns
LAG_STEP = 1e-3  # samples


def tangents_of(state: State, index: int, part: Part, followed: Followed) -> Array:
    """Return d reading / d vector, (rows, numbers)."""
    coordinates = state.coordinates
    rows = np.zeros((len(part.place), len(state.vector)), order="F")
    static, gain = _behind(state, index, part, followed)
    plays, lag = coordinates.shape.plays, coordinates.slices["lag"]
    shared = static[:, plays : plays + lag.start]
    np.multiply(shared, gain, out=rows[:, : lag.start])
    np.multiply(static[:, :plays], gain, out=rows[:, coordinates.memory_slice(index)])
    rows[:, coordinates.offset_slice(index)] = 1.0
    if lag.stop > lag.start:
        rows[:, lag] = _by_lag(state, index, part, followed)[:, None]
    for number, place in enumerate(state.slices):
        rows[:, place] = _by_extension(state, number, index, part, followed)
    return rows


def _behind(state: State, index: int, part: Part, followed: Followed) -> tuple[Array, Array]:
    """Return the columns of the hysteresis behind the filters, at the rows that count, memory
    first; and by how much the extensions scale each row, (rows, 1).
    """
    rate_Hz = part.where.rate_Hz
    late = late_s(state, rate_Hz) * rate_Hz
    whole = int(np.floor(late))
    share = late - whole
    source = np.maximum(part.place - whole, 0)
    newer, older = followed.static[source], followed.static[np.maximum(source - 1, 0)]
    shifted = (1.0 - share) * newer + share * older
    true = passed(state, part, followed.static, instant=True)[part.place]
    width = state.coordinates.slices["lag"].start + state.coordinates.shape.plays
    wide = len(followed.drive) * (width + 1) > LARGEST
    if wide or np.std(true - shifted) < SLOW * np.std(true):
        columns = _columns(state, index, part, followed.drive, source, share)
    else:
        every = np.arange(int(part.place[-1]) + 1)
        columns = _columns(state, index, part, followed.drive, every, None)
        columns = passed(state, part, columns, instant=True)[part.place]
    gain = np.ones(len(followed.drive))
    for extension in state.extensions:
        gain = gain * extension.gain(part.where)
    return columns, gain[part.place, None]


def _columns(
    state: State, index: int, part: Part, drive: Array, source: Samples, share: float | None
) -> Array:
    """Return the static columns at some samples, memory first, then in the vector's order."""
    operator = state.operator
    chain = Chain(
        gap=operator.gap,
        weight=operator.weight,
        memory_slope=state.theta[state.coordinates.memory_slice(index)],
        zones=from_slopes(operator.knot, operator.slope),
        envelope=operator.envelope,
        share=share,
        rate_Hz=part.where.rate_Hz,
    )
    following = Following(chain, float(drive[0]))
    rows = np.empty((len(source), chain.plays + chain.columns), order="F")
    following.rows(drive[: int(source[-1]) + 1], source, rows)
    return rows[:, :-2]


def _by_lag(state: State, index: int, part: Part, followed: Followed) -> Array:
    step_s = LAG_STEP / part.where.rate_Hz
    theta = state.theta.copy()
    theta[state.coordinates.slices["lag"]] += step_s
    moved = State(
        coordinates=state.coordinates,
        theta=theta,
        extensions=state.extensions,
        scales=state.scales,
        rig=state.rig,
    )
    again = follow(moved, index, part).reading
    return np.asarray((again - followed.reading)[part.place] / step_s)


def _by_extension(state: State, number: int, index: int, part: Part, followed: Followed) -> Array:
    extension = state.extensions[number]
    columns = extension.columns(part.where)
    if columns is not None:
        return np.asarray(columns[part.place] / state.scales.displacement_m)
    free = extension.free()
    found = np.zeros((len(part.place), len(free.value)))
    for j, step in enumerate(free.step):
        # A step that would leave the range goes the other way.
        signed = step if free.value[j] + step <= free.upper[j] else -step
        value = free.value.copy()
        value[j] += signed
        again = follow(state.with_extension(number, extension.moved_to(value)), index, part)
        found[:, j] = (again.reading - followed.reading)[part.place] / signed
    return found
