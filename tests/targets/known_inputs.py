"""The known stage designed once, and a plant with a mode: what boxes are tried on."""

from dataclasses import replace
from functools import cache

from benchmarks.varied_chains import Chain, family_from_chains, varied
from piezoid.design.design_stage import design_stage
from piezoid.export.export_stage import export_stage
from piezoid.records.lab import Lab
from piezoid.targets.pid import Pid
from piezoid.targets.target_inputs import TargetInputs
from piezoid.verification.verify_stage import stage_plants
from tests.verification.known_fit import fitted
from tests.verification.rig import AMPLIFIER, MODE, SENSOR, GAIN_m_per_V, RATE_Hz

BLANK = Pid(sampling_rate_Hz=RATE_Hz, rest_V=0.0, minimum_V=-10.0, maximum_V=10.0)


@cache
def exported():
    model = fitted()
    design = design_stage(
        model, model_digest="sha256:none", sampling_rate_Hz=RATE_Hz, forms=("inverse",)
    )
    file = export_stage(model, design, design_digest="sha256:none")
    plants, drawn = stage_plants(file, model, Lab(), draws=2)
    return TargetInputs(
        file=file,
        plants=plants,
        drawn={"x": drawn[0]},
        models={"x": model["x"]},
        designs={"x": design.axes[0]},
        converter_V=(-10.0, 10.0),
    )


def chain(sign=1.0):
    return Chain(
        label="nominal",
        sampling_rate_Hz=RATE_Hz,
        gain=sign * GAIN_m_per_V,
        output_unit="m",
        sections=(AMPLIFIER, MODE, SENSOR),
    )


def family(sign=1.0):
    """A mode of 630 Hz known to 3 %, a gain known to 15 %."""
    own = chain(sign)
    ends = [
        varied(own, gain_factor=gain, mode_factor=mode)
        for gain in (0.85, 1.15)
        for mode in (0.97, 1.03)
    ]
    named = [replace(one, label=f"end {place}") for place, one in enumerate(ends)]
    return family_from_chains(own, named)
