"""All statements about one stage, from its fit to the verification of its controllers."""

from collections.abc import Iterable, Mapping, Sequence

from piezoid.design.design import Design
from piezoid.design.design_statements import design_statements
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit_statements import fit_statements, sentence
from piezoid.identification.quality import Confidence
from piezoid.raw_counts import record_in_counts
from piezoid.records.recording import Recording
from piezoid.statement import Level, Statement, finding, limit
from piezoid.verification.criteria import describe_failure
from piezoid.verification.verification import Verification

TIP_LEVELS = {
    Confidence.HIGH: Level.NOTE,
    Confidence.MEDIUM: Level.WARNING,
    Confidence.LOW: Level.ACTION,
}


def stage_statements(
    model: ActuatorModel,
    *,
    recordings: Iterable[Recording] = (),
    diagnoses: Sequence[Diagnosis] = (),
    undiagnosed: Sequence[str] = (),
    design: Design | None = None,
    undesigned: str = "",
    unshipped: Mapping[str, str] | None = None,
    verification: Verification | None = None,
) -> tuple[Statement, ...]:
    """Return the statements of all steps, without repeats, in the order of the steps.

    Args:
        model: the fitted stage.
        recordings: whose statements are included.
        diagnoses: of the axes.
        undiagnosed: reasons for missing diagnoses.
        design: the controllers.
        undesigned: reason for missing controllers.
        unshipped: reason of each axis that does not ship, by axis.
        verification: of the controllers.
    """
    reasons = unshipped or {}
    statements = verification_statements(verification, stated=tuple(reasons.values()))
    for name, reason in reasons.items():
        statements.append(limit(Level.ACTION, "not_shipped", reason, axis=name))
    statements += [limit(Level.ACTION, "not_diagnosed", text) for text in undiagnosed]
    if undesigned:
        statements.append(limit(Level.ACTION, "not_designed", undesigned))
    of_recordings = {
        f"{recording.name}: {fact.text}": fact
        for recording in recordings
        for fact in recording.statements
    }
    for text in model.remarks:
        fact = of_recordings.pop(text, None)
        quantity = "recordings" if fact is None else fact.quantity
        statements.append(limit(Level.ACTION, quantity, text))
    statements += [limit(fact.level, fact.quantity, text) for text, fact in of_recordings.items()]
    for axis in model.axes.values():
        statements += record_in_counts(fit_statements(axis), axis.counted)
    for diagnosis in diagnoses:
        statements += record_in_counts(diagnosis_statements(diagnosis), diagnosis.counted)
    if design is not None:
        statements += record_in_counts(design_statements(design, model), model.counted)
    tip = model.tunnelling
    statements += [
        limit(TIP_LEVELS[result.confidence], "tunnelling", sentence(reason), axis="z")
        for result in (() if tip is None else (tip.gap_law, tip.loop_plant))
        if result is not None
        for reason in result.reasons
    ]
    if tip is not None and tip.joint is not None and not tip.joint.agree:
        text = (
            "The barriers from sweeps and closed loop disagree. Check the extension per volt and "
            "the calibration of the height."
        )
        statements.append(limit(Level.ACTION, "barrier", text, axis="z"))
    return tuple(dict.fromkeys(statements))


def verification_statements(
    verification: Verification | None, stated: Sequence[str]
) -> list[Statement]:
    """Return statements about failed verdicts, differing builds and missing proofs.

    stated  texts that already name failed verdicts
    """
    if verification is None:
        return []
    failed = {describe_failure(v): v for v in verification.verdicts if not v.passed}
    statements = [
        finding(
            verdict.name,
            f"Failed: {failure}.",
            level=Level.ACTION,
            value=verdict.value,
            unit=verdict.unit,
        )
        for failure, verdict in failed.items()
        if not any(failure in text for text in stated)
    ]
    for proof in verification.proofs:
        if not proof.passed:
            text = f"{proof.differing} of {proof.samples} samples differ: {proof.build}."
            statements.append(finding("build", text, level=Level.ACTION))
    for limit_proof in verification.limit_proofs:
        if not limit_proof.passed:
            text = (
                f"Not proved to stay within its limits in {limit_proof.precision}: "
                f"{limit_proof.verdict}."
            )
            axis = limit_proof.axis
            statements.append(finding("limits", text, level=Level.ACTION, axis=axis))
    return statements
