"""The convex problem around a loop: at that loop itself, all it asks is what the loop reaches."""

import cvxpy as cp
import numpy as np
import pytest

from piezoid.design.cones import (
    _LEAST_REAL,
    _SLACK_PRICE,
    Cones,
    Reached,
    _excess,
    _solved,
    cones_around,
)
from piezoid.design.family_grid import FamilyGrid, family_grid
from piezoid.design.plant import PlantFamily
from piezoid.design.rst import INTEGRATOR, OPEN_AT_NYQUIST
from piezoid.design.sensitivity import sensitivities
from piezoid.numerics.arrays import Array
from tests.design.rig import loop, vertical_family, vertical_specification

FAMILY = PlantFamily(members=vertical_family().members[:3])
SCALE = abs(FAMILY.nominal.gain)
TAPS = 5
R, S = loop(1e3, 0.9)
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


def modelled(cones: Cones, reserve: float) -> float:
    """Return the least cost of the program as a modelling language puts it together."""
    x, gamma, slack = cp.Variable(2 * TAPS - 1), cp.Variable(), cp.Variable(nonneg=True)
    real = cones.real[0] @ x + cones.real[1]
    sizes = [cp.abs(rows @ x + constant) for rows, constant in cones.limited]
    asked = [real >= _LEAST_REAL * cones.reference]
    for size, limit in zip(sizes, cones.limits[:3], strict=True):
        held = np.isfinite(limit)
        room = real[held] + slack * cones.reference[held]
        asked.append(size[held] <= cp.multiply(reserve * limit[held], room))
    band = np.isfinite(cones.slope)
    asked.append(sizes[0][band] <= gamma * (cones.slope * cones.reference)[band])
    asked.append(real[band] >= cones.reference[band])
    cost = cp.Minimize(gamma + _SLACK_PRICE * slack)
    return float(cp.Problem(cost, asked).solve(cp.CLARABEL))


@pytest.mark.parametrize("reserve", [0.9, 0.4], ids=["met", "met with a slack only"])
def test_a_modelling_language_puts_a_program_of_the_same_cost_together(reserve):
    cones = cones_around(grid(), SCALE, R, S, TAPS)
    found = _solved(cones, TAPS, reserve)
    assert found.gamma + _SLACK_PRICE * found.slack == pytest.approx(
        modelled(cones, reserve), rel=3e-4
    )
