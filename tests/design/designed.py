"""Design and export of the known stage, computed once for all tests."""

import json
from functools import cache

import pytest

import piezoid
from piezoid.design.design import Design
from piezoid.design.design_stage import design_stage
from piezoid.identification.store import write_model
from tests.plays_alone import design_briefly
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz


@cache
def known_design() -> Design:
    digest = json.loads(write_model(fitted()))["digest"]
    with pytest.MonkeyPatch.context() as patch:
        design_briefly(patch)
        return design_stage(
            fitted(), model_digest=digest, sampling_rate_Hz=RATE_Hz, forms=("inverse",)
        )


@cache
def known_shipping() -> piezoid.Shipping:
    return piezoid.export(fitted(), known_design())
