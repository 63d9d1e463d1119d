"""The page: records in, one self-contained HTML text out. No clock, no chance, no network."""

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib.resources import files as files_of

from jinja2 import Environment, FunctionLoader, StrictUndefined
from markupsafe import Markup

from piezoid.calibration.calibrate import Calibration
from piezoid.calibration.controllers import Controllers
from piezoid.calibration.stage_statements import stage_statements
from piezoid.design.design import Design
from piezoid.design.design_statements import design_statements
from piezoid.diagnosis.compare import ModelComparison
from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.diagnosis.diagnosis_statements import diagnosis_statements
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.coupled.from_recordings import as_single_axes
from piezoid.identification.fit_statements import GOOD_PERCENT, NEAR_NOISE
from piezoid.identification.store import write_model
from piezoid.raw_counts import in_counts
from piezoid.records.collection import Collection
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid.statement import select
from piezoid_reports.page import Page
from piezoid_reports.parts import Section
from piezoid_reports.plain_text import printable
from piezoid_reports.sections import OF_DESIGN, OF_DIAGNOSIS, SECTIONS, Render

ALARM = (
    "The model does not apply to every axis.",
    "The figures of an axis to which it does not apply only show why.",
)

UNDRAWN = (
    "This page was drawn without the recordings.",
    "Name the files of the fit to have loops and residuals drawn.",
)


def render(page: Page) -> str:
    """Return report.html; recordings that are not of the fit are listed but not drawn."""
    page = replace(
        page,
        recordings=as_single_axes(page.recordings, None, page.model.coupled),
        # What the folder's file carries, whatever version wrote it.
        model_digest=_digest(page.files.get("model.json") or write_model(page.model)),
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
    return _written(replace(page, statements=select(statements)), SECTIONS)


def render_design(model: ActuatorModel, design: Design) -> str:
    """Return design.html: the controllers alone, designed after the fit."""
    page = Page(
        model=model,
        model_digest=_digest(write_model(model)),
        design=design,
        statements=select(design_statements(design, model)),
        has_summary=False,
    )
    return html(_title(model), _sections(page, OF_DESIGN), counted=page.counted)


def render_diagnosis(
    model: ActuatorModel,
    recordings: Sequence[Recording],
    diagnosis: Diagnosis,
    *,
    comparison: ModelComparison | None = None,
    written: bytes = b"",
) -> str:
    """Return diagnosis.html: causes in recordings, against a model that was fitted to them.

    model    to draw on; it is in no file
    comparison  of an earlier model with these recordings
    written  diagnosis.json
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
    return _written(page, OF_DIAGNOSIS)


def _digest(content: bytes) -> str:
    """Return the digest that a sealed file carries."""
    return str(json.loads(content)["digest"])


def _written(page: Page, chapters: Sequence[Render]) -> str:
    alarm = None if page.recordings or not page.model.axes else UNDRAWN
    alarm = alarm if page.model.applies else ALARM
    sections = _sections(page, chapters)
    return html(_title(page.model), sections, alarm=alarm, counted=page.counted)


def _title(model: ActuatorModel) -> str:
    """Return the stage's name, with the word before it where the name does not say it."""
    return model.stage if "stage" in model.stage.lower() else f"Stage {model.stage}"


def _sections(page: Page, chapters: Sequence[Render]) -> list[Section]:
    return [section for make in chapters if (section := make(page)) is not None]


def html(
    title: str,
    sections: Sequence[Section],
    *,
    alarm: tuple[str, str] | None = None,
    counted: Sequence[str] = (),
) -> str:
    """Return the whole page.

    title     a name from the data, shown as text
    sections  its chapters
    alarm     what must be known before anything is read, and why
    counted   what was recorded in counts: no metre, or no volt, is then on the page
    """

    def escaped(value: object) -> object:
        is_text = isinstance(value, str) and not hasattr(value, "__html__")
        return printable(in_counts(str(value), counted) if is_text else value)

    environment = Environment(
        loader=FunctionLoader(_text),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=escaped,
    )
    style, script = _text("style.css"), _text("figures.js")
    return environment.get_template("page.html.j2").render(
        title=title,
        alarm=alarm,
        sections=sections,
        style=Markup(style),
        script=Markup(script),
        policy=policy_for(style, script),
        good_percent=GOOD_PERCENT,
        near_noise=NEAR_NOISE,
    )


def policy_for(style: str, script: str) -> str:
    """Return a policy that runs our two texts and nothing else, and never asks a network."""
    return (
        f"default-src 'none'; style-src '{_hash(style)}'; script-src '{_hash(script)}'; "
        "base-uri 'none'; form-action 'none'"
    )


def _hash(text: str) -> str:
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()


def _text(name: str) -> str:
    return (files_of("piezoid_reports") / "templates" / name).read_text(encoding="utf-8")


def report_of(
    model: ActuatorModel,
    collection: Collection,
    controllers: Controllers,
    *,
    diagnoses: Sequence[Diagnosis],
    undiagnosed: Sequence[str] = (),
    files: Mapping[str, bytes],
    lab: Lab | None,
) -> str:
    """Return report.html of a stage from the records of its calibration.

    collection  recordings of the fit, for the figures
    files       sealed files, for the chain of digests
    """
    page = Page(
        model=model,
        recordings=collection.recordings,
        sweeps=collection.sweeps,
        responses=collection.responses,
        design=controllers.design,
        undesigned=controllers.reason,
        diagnoses=diagnoses,
        undiagnosed=undiagnosed,
        verification=controllers.verification,
        unshipped=controllers.unshipped,
        files=files,
        lab=lab,
    )
    return render(page)


def with_report(
    calibration: Calibration, collection: Collection | None, lab: Lab | None
) -> Calibration:
    """Return a calibration with report.html among its files.

    collection  recordings, for the figures of the report; None if they are larger than memory
    """
    if collection is None:  # a collection of sweeps alone is false as well
        collection = Collection(recordings=(), sweeps=(), responses=())
    page = report_of(
        calibration.model,
        collection,
        calibration.controllers,
        diagnoses=calibration.diagnoses,
        undiagnosed=calibration.undiagnosed,
        files=calibration.files,
        lab=lab,
    )
    return replace(calibration, files={**calibration.files, "report.html": page.encode()})
