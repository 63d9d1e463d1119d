"""The sections of a report, in the order of the page.

Each file has one function, ``render``, from a page to a section or None.
To add one, add a file and its line in ``SECTIONS`` below.
"""

from collections.abc import Callable

from piezoid_reports.page import Page, Section
from piezoid_reports.sections import (
    certificate,
    coupling,
    design,
    diagnosis,
    dynamics,
    limits,
    loading_curve,
    loops,
    measures,
    model_comparison,
    motion,
    orders,
    parameters,
    provenance,
    residual_over_drive,
    residual_over_time,
    tunnelling,
    tunnelling_loop,
    uncertainty,
    verdict,
    verification,
)

Render = Callable[[Page], Section | None]

SECTIONS: tuple[Render, ...] = (
    verdict.render,
    coupling.render,
    measures.render,
    motion.render,
    loops.render,
    residual_over_time.render,
    residual_over_drive.render,
    diagnosis.render,
    loading_curve.render,
    parameters.render,
    orders.render,
    certificate.render,
    uncertainty.render,
    dynamics.render,
    tunnelling.render,
    tunnelling_loop.render,
    design.render,
    verification.render,
    limits.render,
    provenance.render,
)

# What a stage without a single fitted axis still has to say, for example of its tunnelling tip.
OF_STAGE: tuple[Render, ...] = (
    verdict.render,
    coupling.render,
    tunnelling.render,
    tunnelling_loop.render,
    design.render,
    verification.render,
    provenance.render,
)

# A design of its own, made after the fit: what the recordings show stands in the report.
OF_DESIGN: tuple[Render, ...] = (design.render, provenance.render)

# A diagnosis of new recordings of a stage that was fitted before.
OF_DIAGNOSIS: tuple[Render, ...] = (
    model_comparison.render,
    diagnosis.render,
    provenance.render,
)
