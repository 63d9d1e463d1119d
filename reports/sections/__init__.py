"""The sections of the report, in the order of the page.

A new section is one file with a function ``render(page)`` and one line in ``SECTIONS``. It returns
None if the page has nothing to show in it.
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

Render = Callable[[Page], Section | None]

SECTIONS: tuple[Render, ...] = (
    summary.render,
    model_comparison.render,  # only if an earlier model is named
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

# Pages of one verb: a design made after the fit, and a diagnosis of new recordings.
OF_DESIGN: tuple[Render, ...] = (controllers.render, limits.render, provenance.render)
OF_DIAGNOSIS: tuple[Render, ...] = (
    model_comparison.render,
    error_budget.render,
    findings.render,
    limits.render,
    provenance.render,
)
