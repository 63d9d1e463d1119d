"""Steps of a stage from recordings to the report, with the time of each."""

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
DIGEST = "0" * 64  # no file is written


@dataclass(frozen=True, kw_only=True, eq=False)
class ChainResult:
    """Results of the steps, and processor times by the names in the table."""

    model: ActuatorModel
    diagnosis: Diagnosis
    design: Design
    page: str
    time_s: Mapping[str, float]


@dataclass(frozen=True, kw_only=True, eq=False)
class Loop:
    """Plant, controller and reference of one axis."""

    plant: AxisPlant
    parameters: AxisParameters
    reference_m: Array


def run_chain(watch: Stopwatch, campaign: Campaign) -> ChainResult:
    """Run all steps once."""
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
    time_s = dict(zip(STEPS, np.diff(times).tolist(), strict=True))
    time_s["model forward"] = watch.cpu_s(
        lambda: [simulate_recording(model[AXIS], recording) for recording in recordings]
    )
    return ChainResult(
        model=model,
        diagnosis=diagnosis,
        design=design,
        page=page,
        time_s=MappingProxyType(time_s),
    )


def loop_of(result: ChainResult, campaign: Campaign, samples: int) -> Loop:
    """Return the designed controller with the identified plant, and ten sines as reference."""
    file = export_stage(result.model, result.design, design_digest=DIGEST, lab=campaign.lab)
    parameters = file.axis(AXIS)
    low_m, high_m = (float(parameters.values[f"reference_{k}_m"]) for k in ("minimum", "maximum"))
    sine = np.sin(np.linspace(0.0, 20.0 * np.pi, samples))
    reference_m = 0.5 * (low_m + high_m) + 0.3 * (high_m - low_m) * sine
    plant = plant_of(parameters, result.model, campaign.lab)
    return Loop(plant=plant, parameters=parameters, reference_m=reference_m)
