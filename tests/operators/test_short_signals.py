"""Every operator on signals of zero to three samples, constant signals, and a single turn."""

from collections.abc import Callable

import numpy as np
import pytest

from piezoid.numerics.arrays import Array
from piezoid.operators.dead_zone import from_slopes
from piezoid.operators.filters import (
    activated,
    ladder,
    lagged,
    later,
    relaxed,
    slewed,
)
from piezoid.operators.linear import butterworth, recursive_filter, resonance, sample
from piezoid.operators.play import play_columns, turns_of
from piezoid.operators.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from piezoid.operators.wide_hysteresis import (
    HysteresisStates,
    bouc_wen_states,
    class_columns,
    friction_states,
)

SIGNALS = {
    "none": np.zeros(0),
    "one": np.array([0.3]),
    "two": np.array([0.3, -0.2]),
    "three": np.array([0.3, -0.2, 0.9]),
    "constant": np.full(50, 0.4),
    "one turn": np.concatenate([np.linspace(0.0, 1.0, 20), np.linspace(1.0, 0.5, 20)]),
}
THRESHOLD = np.array([0.0, 0.1, 0.4])
OPERATOR = ModifiedPrandtlIshlinskii(
    plays=PrandtlIshlinskii(threshold=THRESHOLD, weight=np.array([1.0, 0.3, 0.2])),
    dead_zones=from_slopes(np.array([-0.5, 0.0, 0.5]), np.array([0.8, 1.0, 1.1, 1.2])),
    voltage_offset_V=0.0,
    displacement_offset_m=0.0,
)
MODE = sample(resonance(200.0, 0.05), 1000.0)
BESSEL = sample(butterworth(3, 100.0), 1000.0)


OPERATORS: dict[str, Callable[[Array], Array]] = {
    "plays": lambda u: play_columns(u, THRESHOLD, np.zeros(3))[0],
    "turns": lambda u: turns_of(u).astype(float),
    "dead zones": OPERATOR.dead_zones.run,
    "modified Prandtl-Ishlinskii": lambda u: OPERATOR.run(u, OPERATOR.virgin_memory())[0],
    "its inverse": lambda u: OPERATOR.inverse_run(u, OPERATOR.virgin_memory())[0],
    "Bouc-Wen": lambda u: bouc_wen_states(u, 1.0, 0.5, 1.5),
    "friction": lambda u: friction_states(u, np.array([0.2, 0.8]), np.zeros(2)),
    "lag": lambda u: relaxed(u, 1e-3, 1000.0),
    "delay": lambda u: later(u, 1.7),
    "slew limit": lambda u: slewed(u, 0.1),
    "thermal activation": lambda u: activated(u, 0.5, 1.0, 1.0),
    "delay or lag": lambda u: lagged(u, "first_order", 2e-3, 1000.0),
    "recursive filter": lambda u: recursive_filter([0.5, 0.1], [1.0, -0.4], u),
    "ladder": lambda u: ladder(u, [1e-2, 0.1], 1000.0, 0.1),
    "mode": lambda u: MODE.run(u)[0],
    "low pass": lambda u: BESSEL.run(u)[0],
}


@pytest.mark.parametrize("length", SIGNALS)
@pytest.mark.parametrize("name", OPERATORS)
def test_an_operator_is_finite_and_of_the_length_of_its_signal(name, length):
    output = np.asarray(OPERATORS[name](SIGNALS[length]))
    assert len(output) == len(SIGNALS[length])
    assert np.isfinite(output).all()


@pytest.mark.parametrize("length", [name for name in SIGNALS if name != "none"])
def test_columns_of_the_wide_class_are_finite(length):
    drive = SIGNALS[length]
    states = HysteresisStates((float(drive[0]),)).follow(drive)
    columns = class_columns(drive, states)
    assert len(columns) == len(drive)
    assert np.isfinite(columns).all()
