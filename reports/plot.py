"""plot: one figure of the report for a notebook, which cannot run the page's own script."""

from dataclasses import dataclass

from piezoid.identification.actuator_model import ActuatorModel
from piezoid.records.recording import Recording
from piezoid_reports.page import Page
from piezoid_reports.parts import figures_in
from piezoid_reports.render import figure_html
from piezoid_reports.sections import loops, residuals
from piezoid_reports.traces import all_traces

KINDS = {"loops": loops.render, "residual": residuals.render}


@dataclass(frozen=True, kw_only=True)
class Drawing:
    """Figures as a notebook shows them."""

    html: str

    def _repr_html_(self) -> str:
        return self.html


def plot(model: ActuatorModel, *recordings: Recording, kind: str = "loops") -> Drawing:
    """Draw the model over recordings it was fitted on, as the report does.

    recordings  of the fit; others have no fitted start and are not drawn
    kind        ``loops`` or ``residual``

    Raises ``ValueError`` for another kind, or where no recording is one of the fit.
    """
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}, expected one of {', '.join(KINDS)}")
    page = Page(
        model=model,
        recordings=recordings,
        traces=all_traces(model, recordings),
        model_digest="",
    )
    section = KINDS[kind](page)
    if section is None:
        raise ValueError("none of these recordings is one the model was fitted on")
    return Drawing(html=figure_html(list(figures_in(section.parts))))
