"""Design and export of the known stage, computed once for all tests."""

import json
from functools import cache

import piezoid
from piezoid.design.design import Design
from piezoid.design.design_stage import design_stage
from piezoid.identification.store import write_model
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz


@cache
def known_design() -> Design:
    digest = json.loads(write_model(fitted()))["digest"]
    return design_stage(
        fitted(), model_digest=digest, sampling_rate_Hz=RATE_Hz, forms=("inverse",)
    )


@cache
def known_shipping() -> piezoid.Shipping:
    return piezoid.export(fitted(), known_design())
