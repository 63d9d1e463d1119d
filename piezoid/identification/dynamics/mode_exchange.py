"""Escape from a poor start: the least useful mode moves to where the residual is largest."""

import numpy as np

from piezoid.errors import IdentificationError
from piezoid.identification.dynamics.curvature import ModalFit
from piezoid.identification.dynamics.frequency_response import ComplexArray
from piezoid.identification.dynamics.maximum_likelihood import maximise_likelihood
from piezoid.identification.dynamics.modal_basis import Lines, Structure, basis
from piezoid.identification.dynamics.periodic_estimate import smoothed
from piezoid.numerics.arrays import Array

EXCHANGES = 3
GOOD_ENOUGH = 1.05  # cost over its expected value at which nothing is looked for
WORTH_IT = 1e-3  # relative fall of the cost below which exchanging ends
NEW_DAMPING = 0.015
LOCAL = 100  # the residual is averaged over so many-th parts of the band


def exchange_modes(
    response: ComplexArray,
    weight: Array,
    lines: Lines,
    structure: Structure,
    fit: ModalFit,
    expected_cost: float,
) -> ModalFit:
    """Move modes while that lowers the cost, and return the best fit.

    Vector fitting from noisy data may leave two modes where one is, and none where another is;
    maximum likelihood cannot cross the valley between. The mode whose loss would cost least is
    put at the largest local residual, and everything is fitted again.

    response, weight, lines, structure  as for ``maximise_likelihood``
    expected_cost                       what the cost would be if the model were true
    """
    for _ in range(EXCHANGES if structure.modes > 1 else 0):
        if fit.cost <= GOOD_ENOUGH * expected_cost:
            break
        shape = _exchanged(response, weight, lines, structure, fit)
        try:
            found = maximise_likelihood(response, weight, lines, structure, shape)
        except IdentificationError:
            break  # the new place makes two terms alike; what we have stands
        if found.cost > fit.cost * (1 - WORTH_IT):
            break
        fit = found
    return fit


def _exchanged(
    response: ComplexArray, weight: Array, lines: Lines, structure: Structure, fit: ModalFit
) -> Array:
    columns = basis(lines, structure, fit.shape)
    model = np.einsum("kc,oic->koi", columns, fit.gains)
    left = (np.abs(weight * (response - model)) ** 2).sum(axis=(1, 2))
    width = max(len(left) // LOCAL // 2 * 2 + 1, 3)
    place = int(np.argmax(smoothed(left[:, None], width)[:, 0]))
    least = int(np.argmin(fit.mode_worth))
    shape = np.array(fit.shape)
    shape[least] = np.log(lines.frequency_Hz[place])
    shape[structure.modes + least] = np.log(NEW_DAMPING)
    return shape
