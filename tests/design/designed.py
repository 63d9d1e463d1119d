"""The known stage, designed once in both forms."""

from functools import cache

import piezoid
from piezoid.design.design import Design
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz


@cache
def known_design() -> Design:
    return piezoid.design(fitted(), sampling_rate_Hz=RATE_Hz)
