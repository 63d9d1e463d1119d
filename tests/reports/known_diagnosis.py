"""A constructed diagnosis for pages."""

from piezoid.diagnosis.diagnosis import (
    BudgetPart,
    Diagnosis,
    Finding,
    HeldOut,
    NotDetected,
    Size,
    Unexplained,
)
from piezoid.diagnosis.effects import EFFECTS

STROKE_m = 2.4e-5
NAMES = tuple(effect.name for effect in EFFECTS)


def finding(
    effect: str,
    share: float = 3e-3,
    rivals: tuple[str, ...] = (),
    experiment: str = "Record another.",
) -> Finding:
    return Finding(
        effect=effect,
        held_out_gain=0.4,
        held_out_rms_before_m=5e-8,
        held_out_rms_after_m=3e-8,
        p_value=1e-5,
        rms_percent=100.0 * share,
        size=Size(value=0.5, unit="<b>percent</b>", ci95=(0.4, 0.6)),
        not_separable_from=rivals,
        explanation="What was <i>found</i>.",
        next_experiment=experiment,
        parameters={},
    )


def diagnosed(*findings: Finding) -> Diagnosis:
    detected = {finding.effect for finding in findings}
    return Diagnosis(
        axis="x",
        stroke_m=STROKE_m,
        baseline=HeldOut(rms_m=5e-8, rms_percent=0.2),
        final=HeldOut(rms_m=3e-8, rms_percent=0.12, explained_rms_m=2.5e-8),
        envelope_rms_m=2.2e-8,
        noise_floor_rms_m=5e-9,
        explained_fraction=0.64,
        unexplained=Unexplained(
            rms_m=1.9e-8, share=0.94, p_value=0.04, coordinate="drive", gain=0.05
        ),
        budget=(
            BudgetPart(part="creep", rms_m=4e-8, is_explained=True, text="Creep, modelled."),
            BudgetPart(part="loop_shape", rms_m=2.96e-8, is_explained=False, text="Loop shape."),
            BudgetPart(part="noise", rms_m=5e-9, is_explained=False, text="Sensor noise."),
        ),
        findings=findings,
        not_detected=tuple(
            NotDetected(
                effect=name,
                upper_bound_m=None if name == "creep" else 1e-9 * (1 + k),
                detection_limit_m=None if name == "creep" else 2e-9 * (1 + k),
                reason="It was not there.",
                next_experiment="Record another.",
            )
            for k, name in enumerate(NAMES)
            if name not in detected
        ),
    )
