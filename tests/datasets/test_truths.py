"""The drawn ceramics solve their equations; test_zoo.py has the properties of every law."""

from types import SimpleNamespace

import numpy as np

from piezoid_datasets.virtual_lab.truths.closed_form import (
    bent_scale,
    bouc_wen_memory,
    wall_pinning_memory,
)
from piezoid_datasets.virtual_lab.truths.return_point import Everett, preisach_memory
from piezoid_datasets.virtual_lab.truths.truth import FLOOR, branches

from .fields import walk

EVERETT = Everett(
    weight=np.array([0.7, 0.5]),
    centre=np.array([[-0.3, 0.4], [0.1, -0.5]]),
    width=np.array([[0.8, 1.2], [1.0, 1.5]]),
)


def test_branches_cut_a_path_at_its_reversals():
    path = np.array([0.0, 0.0, 1.0, 2.0, 2.0, 1.0, 1.0, 3.0])
    assert list(branches(path)) == [(0, 4, True), (4, 6, False), (6, 7, True)]
    assert list(branches(np.zeros(3))) == []


def test_a_preisach_ceramic_is_the_sum_of_its_relays():
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


def test_a_bouc_wen_ceramic_solves_its_equation():
    law = SimpleNamespace(sharpness=1.4, beta=1.8, gamma=0.3, bend=0.2)
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, points=4000)
    p = bent_scale(path, law.bend)
    z = np.empty_like(path)
    z[0] = -((law.beta + law.gamma) ** (-1.0 / law.sharpness))
    for k in range(1, len(path)):  # Heun's steps of the equation as printed
        dp = p[k] - p[k - 1]
        now = _bouc_wen_slope(law, z[k - 1], dp)
        z[k] = z[k - 1] + 0.5 * dp * (now + _bouc_wen_slope(law, z[k - 1] + dp * now, dp))
    output = bouc_wen_memory(path, **vars(law))
    steepest = 2.0 * law.beta / (law.beta + law.gamma)
    assert np.max(np.abs(output - (steepest * p - z))) < 1e-5  # Heun's own error


def _bouc_wen_slope(law: SimpleNamespace, z: float, dp: float) -> float:
    grip: float = law.gamma + law.beta * np.sign(z * dp)
    return 1.0 - abs(z) ** law.sharpness * grip


def test_a_pinned_wall_solves_its_equation():
    path = walk(FLOOR, 0.9, -0.6, 0.3, -0.9, points=4000)
    wall = np.empty_like(path)
    output = wall_pinning_memory(np.tanh, 0.4, path)
    wall[0] = output[0]
    for k in range(1, len(path)):  # midpoint steps of the equation as printed
        step = abs(path[k] - path[k - 1])
        target = np.tanh(0.5 * (path[k] + path[k - 1]))
        wall[k] = wall[k - 1] + step / 0.4 * (target - wall[k - 1]) / (1.0 + step / 0.8)
    assert np.max(np.abs(output - wall)) < 1e-5  # the midpoint rule's own error
