"""Render records as one self-contained HTML page, without clock, random numbers or network."""

from collections.abc import Sequence
from dataclasses import replace

from piezoid.calibration.calibrate import Calibration
from piezoid.calibration.stage_statements import stage_statements
from piezoid.design.design import Design
from piezoid.design.design_statements import design_statements
from piezoid.diagnosis.compare import ModelComparison
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
from piezoid.digests import digest_in
from piezoid.identification.actuator_model import ActuatorModel, SourceFile
from piezoid.identification.coupled.from_recordings import as_single_axes
from piezoid.identification.store import write_model
from piezoid.records.collection import Collection
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.statement import select
from piezoid_reports.page import Page
from piezoid_reports.parts import html
from piezoid_reports.sections import DESIGN_SECTIONS, DIAGNOSIS_SECTIONS, SECTIONS, Renderer

ALARM = (
    "The model does not apply to every axis.",
    "The figures of a rejected axis only show why it was rejected.",
)

NO_RECORDINGS = (
    "This page was made without the recordings.",
    "Name the files of the fit to plot loops and residuals.",
)

INCOMPLETE = (
    "Loops, residuals and their numbers are of the others alone; the model and its errors are of "
    "all."
)


def render(page: Page) -> str:
    """Return report.html; recordings outside the fit are listed but not plotted."""
    single = as_single_axes(page.recordings, None, page.model.coupled)
    available: tuple[SourceFile, ...] = (*page.recordings, *single, *page.sweeps, *page.responses)
    missing = page.model.missing_recordings(available) if available else ""
    page = replace(
        page,
        recordings=single,
        # The digest in the folder's model.json, whichever version wrote it.
        model_digest=digest_in(page.files.get("model.json") or write_model(page.model)),
    )
    statements = stage_statements(
        page.model,
        recordings=page.recordings,
        diagnoses=page.diagnoses,
        undiagnosed=page.undiagnosed,
        design=page.design,
        undesigned=page.undesigned,
        unshipped=page.unshipped,
        verification=page.verification,
    )
    page = replace(page, statements=select(statements))
    return _page_html(page, SECTIONS, alarm=_alarm(page, missing))


def render_design(model: ActuatorModel, design: Design) -> str:
    """Return design.html, which shows only the controllers."""
    page = Page(
        model=model,
        model_digest=digest_in(write_model(model)),
        design=design,
        statements=select(design_statements(design, model)),
        has_summary=False,
    )
    return _page_html(page, DESIGN_SECTIONS, alarm=None)


def render_diagnosis(
    model: ActuatorModel,
    recordings: Sequence[Recording],
    diagnosis: Diagnosis,
    *,
    comparison: ModelComparison | None = None,
    written: bytes = b"",
) -> str:
    """Return diagnosis.html: effects in recordings, shown with a model fitted to them.

    model       for the figures; it is saved in no file
    comparison  of an earlier model with these recordings
    written     content of diagnosis.json
    """
    page = Page(
        model=model,
        recordings=recordings,
        diagnoses=(diagnosis,),
        comparison=comparison,
        files={"diagnosis.json": written} if written else {},
        statements=select(diagnosis_statements(diagnosis)),
        has_summary=False,
    )
    return _page_html(page, DIAGNOSIS_SECTIONS, alarm=_alarm(page))


def _alarm(page: Page, missing: str = "") -> tuple[str, str] | None:
    """Return the warning above the sections and its explanation, or None.

    missing  recordings of the fit that the page was made without, as a sentence
    """
    if not page.model.applies:
        title, explanation = ALARM
        return title, f"{explanation} {missing}".strip()
    if page.model.axes and not page.recordings:
        return NO_RECORDINGS
    return (missing, INCOMPLETE) if missing else None


def _page_html(page: Page, renderers: Sequence[Renderer], *, alarm: tuple[str, str] | None) -> str:
    stage = page.model.stage
    title = stage if "stage" in stage.lower() else f"Stage {stage}"
    sections = [section for make in renderers if (section := make(page)) is not None]
    return html(title, sections, alarm=alarm, counted=page.counted)


def with_report(calibration: Calibration, collection: Collection, lab: Lab | None) -> Calibration:
    """Return the calibration with report.html added to its files.

    collection  recordings, for the figures of the report; none if they are larger than memory
    """
    controllers = calibration.controllers
    page = Page(
        model=calibration.model,
        recordings=collection.recordings,
        sweeps=collection.sweeps,
        responses=collection.responses,
        design=controllers.design,
        undesigned=controllers.reason,
        diagnoses=calibration.diagnoses,
        undiagnosed=calibration.undiagnosed,
        verification=controllers.verification,
        unshipped=controllers.unshipped,
        files=calibration.files,
        lab=lab,
    )
    return replace(calibration, files={**calibration.files, "report.html": render(page).encode()})
