"""Inputs of the target tests: the exported known stage, and a family with a mode."""

import csv
import io
from dataclasses import replace
from functools import cache

from benchmarks.varied_chains import family_from_chains, varied
from piezoid.design.design_stage import design_stage
from piezoid.export.export_stage import export_stage
from piezoid.records.lab import Lab
from piezoid.targets.pid import Pid
from piezoid.targets.target_inputs import TargetInputs
from piezoid.verification.verify_stage import stage_plants
from tests.design.rig import lateral_chain
from tests.verification.known_fit import fitted
from tests.verification.rig import GAIN_m_per_V, RATE_Hz

BLANK = Pid(sampling_rate_Hz=RATE_Hz, rest_V=0.0, minimum_V=-10.0, maximum_V=10.0)


def csv_rows(content):
    """Return the rows of a CSV file by the names of its columns."""
    return list(csv.DictReader(io.StringIO(content.decode())))


@cache
def exported():
    model = fitted()
    design = design_stage(
        model, model_digest="sha256:none", sampling_rate_Hz=RATE_Hz, forms=("inverse",)
    )
    file = export_stage(model, design, design_digest="sha256:none")
    plants, variations = stage_plants(file, model, Lab(), draws=2)
    return TargetInputs(
        file=file,
        plants=plants,
        drawn={"x": variations[0]},
        models={"x": model["x"]},
        designs={"x": design.axes[0]},
        converter_V=(-10.0, 10.0),
    )


def chain(sign=1.0):
    return replace(lateral_chain(sign * GAIN_m_per_V), label="nominal")


def family(sign=1.0):
    """Return plants with a mode at 630 Hz +- 3 % and a gain of +- 15 %."""
    nominal = chain(sign)
    corners = [
        varied(nominal, gain_factor=gain, mode_factor=mode)
        for gain in (0.85, 1.15)
        for mode in (0.97, 1.03)
    ]
    labelled = [replace(corner, label=f"end {index}") for index, corner in enumerate(corners)]
    return family_from_chains(nominal, labelled)
