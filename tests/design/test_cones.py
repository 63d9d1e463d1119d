"""The convex problem around a loop: at that loop itself, all it asks is what the loop reaches."""

import numpy as np
import pytest
from scipy.optimize import linprog

from piezoid.design.family_grid import FamilyGrid, family_grid
from piezoid.design.plant import PlantFamily
from piezoid.design.rst import INTEGRATOR, OPEN_AT_NYQUIST
from piezoid.design.sensitivity import sensitivities
from piezoid.design.youla import (
    _LEAST_REAL,
    _SLACK_PRICE,
    Cones,
    Reached,
    _excess,
    _solved,
    cones_around,
)
from piezoid.numerics.arrays import Array
from tests.design.rig import loop, vertical_family, vertical_specification

FAMILY = PlantFamily(members=vertical_family().members[:3])
SCALE = abs(FAMILY.nominal.gain)
TAPS = 5
R, S = loop(1e3, 0.9)
SIDES = 64
LEFT = 1e-3  # where slack is needed the solver calls its answer inaccurate
SOLVED = 1e-5  # what an interior point leaves of a constraint that is met exactly


def grid() -> FamilyGrid:
    return family_grid(FAMILY, vertical_specification(100.0), count=40)


def unknowns() -> Array:
    """R and S in the words of the problem: s'_1.., then scale r'_0.. ."""
    s_free = np.polydiv(S, INTEGRATOR)[0]
    r_free = np.polydiv(R, OPEN_AT_NYQUIST)[0] * SCALE
    return np.concatenate(
        [np.pad(s_free[1:], (0, TAPS - len(s_free))), np.pad(r_free, (0, TAPS - len(r_free)))]
    )


def functions(place: FamilyGrid) -> list[Array]:
    """Syp, Sup, Syb by another way, members after each other."""
    found = [sensitivities(m, R, S, place.frequency_Hz) for m in FAMILY.members]
    names = ("Syp", "Sup", "Syb")
    return [np.concatenate([np.abs(getattr(f, name)) for f in found]) for name in names]


def test_the_rows_are_the_loops_numerators_over_its_own_polynomial():
    place, x = grid(), unknowns()
    cones = cones_around(place, SCALE, R, S, TAPS)
    sizes = [np.abs(rows @ x + constant) / cones.reference for rows, constant in cones.limited]
    np.testing.assert_allclose(sizes, functions(place), rtol=1e-9)
    # P_i conj(P_d,i) is real and positive where both are one polynomial.
    np.testing.assert_allclose(cones.real[0] @ x + cones.real[1], cones.reference, rtol=1e-9)


@pytest.mark.parametrize("gamma", [0.5, 50.0])
@pytest.mark.parametrize("reserve", [0.9, 1.0])
@pytest.mark.parametrize("slack", [0.0, 0.25])
def test_what_a_loop_misses_is_what_its_sensitivities_exceed(gamma, reserve, slack):
    place = grid()
    cones = cones_around(place, SCALE, R, S, TAPS)
    found = _excess(cones, Reached(x=unknowns(), gamma=gamma, slack=slack), reserve)
    limits = np.tile(place.limits[:3], len(FAMILY.members))
    over = np.max(np.array(functions(place)) / limits, axis=0) - reserve * (1.0 + slack)
    f = np.tile(place.frequency_Hz, len(FAMILY.members))
    inside = f <= 100.0 * (1.0 + 1e-12)
    floor = _LEAST_REAL - 1.0  # P keeps some of P_d everywhere
    # Within the band P may not fall below P_d, and here it is P_d.
    above_line = np.where(inside, np.maximum(functions(place)[0] * 100.0 / f - gamma, 0.0), floor)
    np.testing.assert_allclose(found, np.maximum(over, above_line), atol=1e-9)


def test_a_solution_of_all_rows_misses_none_and_uses_what_it_may():
    cones = cones_around(grid(), SCALE, R, S, TAPS)
    found = _solved(cones, TAPS, 0.9)
    assert found is not None
    excess = _excess(cones, found, 0.9)
    assert abs(excess.max()) < SOLVED
    assert (excess > -SOLVED).sum() > 2  # a least gamma leans on several rows
    assert found.slack < SOLVED
    present = np.max(functions(grid())[0] * np.nan_to_num(1.0 / cones.slope))
    assert found.gamma < 0.9 * present


def between_polygons(cones: Cones, reserve: float) -> list[float]:
    """Least costs of two linear programs: |z| by polygons around and inside its circle."""
    none, reference = np.zeros(len(cones.reference)), cones.reference
    real = np.column_stack([cones.real[0], none, reference])  # x, gamma, slack
    band = np.isfinite(cones.slope)
    rise = np.zeros((int(band.sum()), 2 * TAPS + 1))
    rise[:, -2] = (cones.slope * reference)[band]
    circles = [(cones.A_S, band, rise, np.zeros(len(rise)))]
    for size, limit in zip(cones.limited, cones.limits[:3], strict=True):
        held = np.isfinite(limit)
        share = reserve * limit[held]
        circles.append((size, held, share[:, None] * real[held], share * cones.real[1][held]))
    plain = np.pad(cones.real[0], ((0, 0), (0, 2)))
    found = []
    for inside in (1.0, np.cos(np.pi / SIDES)):
        A = [-plain, -plain[band]]
        b = [cones.real[1] - _LEAST_REAL * reference, (cones.real[1] - reference)[band]]
        for (rows, constant), held, bound, offset in circles:
            for turn in np.exp(2j * np.pi * np.arange(SIDES) / SIDES):
                A.append(np.pad((turn * rows[held]).real, ((0, 0), (0, 2))) - inside * bound)
                b.append(inside * offset - (turn * constant[held]).real)
        cost = np.zeros(2 * TAPS + 1)
        cost[-2:] = 1.0, _SLACK_PRICE
        free = [(None, None)] * (2 * TAPS) + [(0.0, None)]
        done = linprog(cost, np.vstack(A), np.concatenate(b), bounds=free)
        found.append(float(done.fun))
    return found


@pytest.mark.parametrize("reserve", [0.9, 0.4], ids=["met", "met with a slack only"])
def test_the_least_cost_lies_between_those_of_two_linear_programs(reserve):
    cones = cones_around(grid(), SCALE, R, S, TAPS)
    found = _solved(cones, TAPS, reserve)
    low, high = between_polygons(cones, reserve)
    assert high < 1.02 * low
    cost = found.gamma + _SLACK_PRICE * found.slack
    assert (1.0 - LEFT) * low < cost < (1.0 + LEFT) * high
