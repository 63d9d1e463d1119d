"""The way of a stage from recordings to the report, each step timed on what was made before."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from benchmarks.speed.campaign import AXIS, Campaign
from benchmarks.speed.stopwatch import Stopwatch, used_s
from piezoid.design.design import Design
from piezoid.design.design_stage import design_stage
from piezoid.diagnosis.diagnose import diagnose
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.export.export_stage import export_stage
from piezoid.export.parameter_file import AxisParameters
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit import fit
from piezoid.identification.simulation import simulate_recording
from piezoid.numerics.arrays import Array
from piezoid.verification.plant import AxisPlant
from piezoid.verification.verify_stage import plant_of
from piezoid_reports.page import Page
from piezoid_reports.render import render

STEPS = ("fit, all of it", "diagnosis", "design", "report")
DIGEST = "0" * 64  # nothing here is written, so nothing is sealed


@dataclass(frozen=True, kw_only=True, eq=False)
class Made:
    """What the steps made, and the processor time each took, by its name in the table."""

    model: ActuatorModel
    diagnosis: Diagnosis
    design: Design
    page: str
    time_s: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """One axis to be run in closed loop."""

    plant: AxisPlant
    parameters: AxisParameters
    reference_m: Array


def walked(watch: Stopwatch, campaign: Campaign) -> Made:
    """Walk the whole way once."""
    recordings, lab, times = campaign.recordings, campaign.lab, [used_s()]
    model = fit(recordings, lab=lab)
    times.append(used_s())
    diagnosis = diagnose(recordings, axis=AXIS, lab=lab, model=model[AXIS])
    times.append(used_s())
    design = design_stage(model, model_digest=DIGEST, lab=lab)
    times.append(used_s())
    page = render(
        Page(model=model, recordings=recordings, design=design, diagnoses=(diagnosis,), lab=lab)
    )
    times.append(used_s())
    found = dict(zip(STEPS, np.diff(times).tolist(), strict=True))
    found["model forward"] = watch.cpu_s(
        lambda: [simulate_recording(model[AXIS], one) for one in recordings]
    )
    return Made(
        model=model,
        diagnosis=diagnosis,
        design=design,
        page=page,
        time_s=MappingProxyType(found),
    )


def loop_of(made: Made, campaign: Campaign, samples: int) -> Loop:
    """Return the designed axis against its identified stage, along ten sines."""
    held = export_stage(made.model, made.design, design_digest=DIGEST, lab=campaign.lab)
    parameters = held.axis(AXIS)
    ends = [float(parameters.values[f"reference_{end}_m"]) for end in ("minimum", "maximum")]
    reversals = np.sin(np.linspace(0.0, 20.0 * np.pi, samples))
    reference_m = np.mean(ends) + 0.3 * (ends[1] - ends[0]) * reversals
    plant = plant_of(parameters, made.model, campaign.lab)
    return Loop(plant=plant, parameters=parameters, reference_m=reference_m)
