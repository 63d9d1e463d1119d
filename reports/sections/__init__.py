"""The sections of the report, in the order of the page.

A new section is one file with a function ``render(page)`` and one line in ``SECTIONS``. ``render``
returns None if the page has nothing to show in the section.
"""

from collections.abc import Callable

from piezoid_reports.page import Page
from piezoid_reports.parts import Section
from piezoid_reports.sections import (
    controllers,
    dynamics,
    error_budget,
    findings,
    limits,
    loops,
    model_comparison,
    parameters,
    provenance,
    residuals,
    summary,
    tunnelling,
    verification,
)

Renderer = Callable[[Page], Section | None]

SECTIONS: tuple[Renderer, ...] = (
    summary.render,
    model_comparison.render,
    error_budget.render,
    loops.render,
    residuals.render,
    findings.render,
    dynamics.render,
    tunnelling.render,
    controllers.render,
    verification.render,
    parameters.render,
    limits.render,
    provenance.render,
)

# Sections of design.html and diagnosis.html.
DESIGN_SECTIONS: tuple[Renderer, ...] = (controllers.render, limits.render, provenance.render)
DIAGNOSIS_SECTIONS: tuple[Renderer, ...] = (
    model_comparison.render,
    error_budget.render,
    findings.render,
    limits.render,
    provenance.render,
)
