"""Switching states against their equation, and against another program of the same law."""

from itertools import pairwise

import numpy as np
import pytest

from piezoid.operators.switching import switching_states
from piezoid_datasets.virtual_lab.truths.duhem import Duhem, duhem_memory

UP, DOWN = np.array([0.3, 0.7]), np.array([-0.2, -0.5, -0.9])
START = np.linspace(-0.8, 0.8, 6)
PASSAGE, WIDTH = 1.8, 0.4


def followed(way: np.ndarray, start: np.ndarray = START) -> np.ndarray:
    return switching_states(way, UP, DOWN, start, passage=PASSAGE, width=WIDTH)


def density(field: np.ndarray, drive: float) -> np.ndarray:
    gauss = np.exp(-(((drive - field) / WIDTH) ** 2))
    return np.asarray(PASSAGE / (np.sqrt(np.pi) * WIDTH) * gauss)


def test_each_pair_of_fields_solves_its_equation() -> None:
    way = np.sin(np.linspace(0.0, 9.0, 20_001)) * np.linspace(1.2, 0.3, 20_001)
    up, down = (part.ravel() for part in np.meshgrid(UP, DOWN, indexing="ij"))
    state = START.copy()
    for before, after in pairwise(way.tolist()):
        middle, step = 0.5 * (before + after), after - before
        # of dx = (1 - x) A du rising, (1 + x) B du falling, by the trapezoidal rule
        side, rate = (1.0, density(up, middle)) if step > 0 else (-1.0, density(down, middle))
        half = 0.5 * rate * abs(step)
        state = side + (state - side) * (1.0 - half) / (1.0 + half)
    np.testing.assert_allclose(followed(way)[-1], state, atol=1e-7)


def test_one_state_is_the_law_that_the_laboratory_has_for_a_ceramic() -> None:
    law = Duhem(
        rate=PASSAGE / (np.sqrt(np.pi) * WIDTH),
        centre=0.0,
        coercive=(0.7, 0.5),
        width=(WIDTH, WIDTH),
    )
    way = np.concatenate([np.linspace(a, b, 600) for a, b in pairwise([-1.0, 1.0, -0.4, 0.6])])
    found = switching_states(
        way, UP[1:], DOWN[1:2], np.array([-1.0]), passage=PASSAGE, width=WIDTH
    )
    np.testing.assert_allclose(found[:, 0], duhem_memory(law, way), atol=1e-12)


def test_only_the_turns_of_the_drive_are_known_and_where_it_rests_nothing_moves() -> None:
    turns = np.array([0.0, 1.0, -0.6, 0.2, 0.2, -0.1])
    finely = followed(np.concatenate([np.linspace(a, b, 300) for a, b in pairwise(turns)]))[-1]
    coarsely = followed(turns)
    np.testing.assert_allclose(coarsely[-1], finely, rtol=1e-12)
    np.testing.assert_array_equal(coarsely[0], START)
    np.testing.assert_array_equal(coarsely[3], coarsely[4])


def test_what_it_forgets_does_not_depend_on_where_it_began() -> None:
    way = np.sin(np.linspace(0.0, 5.0, 3_000))
    kept = followed(way, START + 0.1) - followed(way, START)
    np.testing.assert_allclose(followed(way, START - 0.2) - followed(way, START), -2.0 * kept)
    assert kept[-1].max() < 0.05  # of 0.1


def test_more_fields_than_fit_are_refused() -> None:
    with pytest.raises(ValueError, match="found 9 fields, but at most 8"):
        switching_states(np.zeros(2), np.zeros(5), np.zeros(4), np.zeros(20), passage=1.0, width=1)
