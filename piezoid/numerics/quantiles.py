"""Quantiles of the normal distribution and of Student's t, without loading all distributions."""

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import ndtri, stdtrit

from piezoid.numerics.arrays import Array

NORMAL_95 = 1.959963984540054
"""Half the width of a 95 % interval of a normal distribution, in standard deviations."""


def normal_quantile(probability: ArrayLike) -> Array:
    """Return the values below which a standard normal one lies with these probabilities."""
    return np.asarray(ndtri(probability))


def student_quantile(probability: ArrayLike, freedom: ArrayLike) -> Array:
    """Return the values below which Student's t lies with these probabilities.

    probability  (...)  0 to 1
    freedom      (...)  degrees of freedom, > 0; infinite: the normal distribution
    """
    known = np.isinf(freedom)
    finite = stdtrit(np.where(known, 1.0, freedom), probability)
    return np.asarray(np.where(known, ndtri(probability), finite))
