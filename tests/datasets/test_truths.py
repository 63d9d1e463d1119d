"""The ceramics are what their books say, and none of them is a sum of plays."""

import numpy as np
import pytest

from piezoid_datasets.virtual_lab.truths import TRUTHS
from piezoid_datasets.virtual_lab.truths.bouc_wen import BoucWen, bouc_wen_memory
from piezoid_datasets.virtual_lab.truths.branches import branches
from piezoid_datasets.virtual_lab.truths.preisach import Everett, preisach_memory
from piezoid_datasets.virtual_lab.truths.truth import FLOOR, Ceramic, Truth
from piezoid_datasets.virtual_lab.truths.wall_pinning import wall_pinning_memory

from .fields import EXACT, Array, strain, walk

EVERETT = Everett(
    weight=np.array([0.7, 0.5]),
    centre=np.array([[-0.3, 0.4], [0.1, -0.5]]),
    width=np.array([[0.8, 1.2], [1.0, 1.5]]),
)

every_truth = pytest.mark.parametrize("truth", TRUTHS, ids=lambda truth: truth.name)


def loop(ceramic: Ceramic, low: float, high: float) -> Array:
    """Return the second round of a minor loop, from its lower end and its first value."""
    rounds = strain(ceramic, walk(-1.0, low, high, low, high, low))[-120:]
    return rounds - rounds[0]


def preisach(seed: int = 3) -> Ceramic:
    return TRUTHS[0].draw(np.random.default_rng(seed))


def test_branches_cut_a_path_at_its_reversals() -> None:
    path = np.array([0.0, 0.0, 1.0, 2.0, 2.0, 1.0, 1.0, 3.0])
    assert list(branches(path)) == [(0, 4, True), (4, 6, False), (6, 7, True)]
    assert list(branches(np.zeros(3))) == []


def test_a_preisach_ceramic_is_the_sum_of_its_relays() -> None:
    grid = np.linspace(FLOOR, 1.2, 421)
    middle, cell = 0.5 * (grid[1:] + grid[:-1]), (grid[1] - grid[0]) ** 2
    above, below = np.meshgrid(middle, middle, indexing="ij")
    slopes = [
        [1.0 / w / np.cosh((middle - c) / w) ** 2 for c, w in zip(cs, ws, strict=True)]
        for cs, ws in zip(EVERETT.centre.T, EVERETT.width.T, strict=True)
    ]
    density = sum(
        c * (np.outer(p, q) + np.outer(q, p))
        for c, (p, q) in zip(EVERETT.weight, slopes, strict=True)
    )
    weight = np.where(above > below, density, np.where(above == below, 0.5 * density, 0.0)) * cell
    up = np.zeros(above.shape, dtype=bool)
    path = walk(FLOOR, 1.0, -0.6, 0.4, -0.2, 0.8, -1.0, points=30)
    summed = np.empty_like(path)
    for k, field in enumerate(path):
        up = (up | (above <= field)) & (below < field)
        summed[k] = weight[up].sum()
    output = preisach_memory(EVERETT, path)
    assert np.max(np.abs(output - summed)) < 0.02 * np.ptp(output)  # two cells of the grid


def test_a_preisach_ceramic_forgets_an_excursion_when_the_field_passes_its_ends() -> None:
    plain = strain(preisach(), walk(-1.0, 0.7, -0.5, 0.2))
    detour = strain(preisach(), walk(-1.0, 0.7, -0.5, 0.2, -0.3, 0.1, -0.1, 0.2))
    assert abs(plain[-1] - detour[-1]) < EXACT


def test_a_preisach_ceramic_draws_equal_minor_loops_after_unlike_pasts() -> None:
    shapes = []
    for turns in ((-1.0, 0.9, -0.2), (1.0, -0.8, 0.9, -0.2), (-1.0, -0.2)):
        path = walk(*turns, 0.3, -0.2, 0.3, -0.2, points=40)
        shapes.append(strain(preisach(), path)[-80:])
    for shape in shapes[1:]:
        assert np.allclose(shape - shape[0], shapes[0] - shapes[0][0], atol=EXACT)


@every_truth
def test_no_ceramic_is_a_sum_of_plays(truth: Truth) -> None:
    """Loops of equal span would coincide at every bias; these differ by far more than rounding."""
    for seed in range(5):
        ceramic = truth.draw(np.random.default_rng(seed))
        low, high = loop(ceramic, -0.8, -0.3), loop(ceramic, 0.3, 0.8)
        assert np.max(np.abs(low - high)) > 0.01 * np.ptp(low)


@every_truth
def test_a_ceramic_does_not_know_how_fast_it_is_driven(truth: Truth) -> None:
    ceramic = truth.draw(np.random.default_rng(8))
    turns = (-1.0, 0.8, -0.4, 0.5, -0.9, 1.0)
    slow = strain(ceramic, walk(*turns, points=500))
    fast = strain(ceramic, walk(*turns, points=2))
    assert np.allclose(slow[[0, *range(499, 2500, 500)]], fast[[0, 1, 3, 5, 7, 9]], atol=1e-7)


@every_truth
def test_the_major_loop_spans_the_stroke_and_opens_like_a_piezo(truth: Truth) -> None:
    for seed in range(10):
        ceramic = truth.draw(np.random.default_rng(seed))
        output = strain(ceramic, walk(1.0, -1.0, 1.0, points=300))
        opening = np.max(output[:300][::-1] - output[300:])
        assert abs(output[-1] - output[300] - 1.0) < 1e-3
        assert 0.07 < opening < 0.16
        assert 0.0 < ceramic.share < 1.0


@every_truth
def test_more_field_is_never_less_strain(truth: Truth) -> None:
    for seed in range(10):
        ceramic = truth.draw(np.random.default_rng(seed))
        field = walk(-1.0, 0.9, -0.7, 0.2, -0.3, 1.0)
        moved, driven = np.diff(strain(ceramic, field)), np.diff(field)
        assert np.all(moved * np.sign(driven) >= 0.0)


def test_a_bouc_wen_ceramic_solves_its_equation() -> None:
    law = BoucWen(sharpness=1.4, beta=1.8, gamma=0.3, bend=0.2)
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, points=4000)
    p = law.scale(path)
    z = np.empty_like(path)
    z[0] = -law.saturation
    for k in range(1, len(path)):  # Heun's steps of the equation as printed
        dp = p[k] - p[k - 1]
        now = _bouc_wen_slope(law, z[k - 1], dp)
        z[k] = z[k - 1] + 0.5 * dp * (now + _bouc_wen_slope(law, z[k - 1] + dp * now, dp))
    output = bouc_wen_memory(law, path)
    assert np.max(np.abs(output - (law.steepest * p - z))) < 1e-5  # Heun's own error


def _bouc_wen_slope(law: BoucWen, z: float, dp: float) -> float:
    grip: float = law.gamma + law.beta * np.sign(z * dp)
    return 1.0 - abs(z) ** law.sharpness * grip


def test_a_bouc_wen_minor_loop_does_not_close() -> None:
    ceramic = TRUTHS[1].draw(np.random.default_rng(2))
    output = strain(ceramic, walk(-1.0, 0.2, -0.2, 0.2))
    assert abs(output[-1] - output[59]) > 1e-3


def test_a_pinned_wall_solves_its_equation() -> None:
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, points=4000)
    wall = np.empty_like(path)
    output = wall_pinning_memory(np.tanh, 0.4, path)
    wall[0] = output[0]
    for k in range(1, len(path)):  # midpoint steps of the equation as printed
        step = abs(path[k] - path[k - 1])
        target = np.tanh(0.5 * (path[k] + path[k - 1]))
        wall[k] = wall[k - 1] + step / 0.4 * (target - wall[k - 1]) / (1.0 + step / 0.8)
    assert np.max(np.abs(output - wall)) < 1e-5  # the midpoint rule's own error
