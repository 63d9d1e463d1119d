"""Limits of the results, with the experiment or repair that improves them most."""

from dataclasses import replace

from piezoid.identification.fit_statements import DYNAMICS
from piezoid.statement import Level, Statement
from piezoid_reports.page import Page
from piezoid_reports.parts import Part, Prose, Section, Table, folded_listing
from piezoid_reports.quantities import number
from piezoid_reports.sections.error_budget import label_of

LABELS = {Level.ACTION: "action", Level.WARNING: "note"}


def render(page: Page) -> Section:
    """Return warnings and actions in a table, and notes and untested conditions in folds."""
    open_facts = [
        fact for fact in page.statements if fact.level > Level.NOTE and fact not in page.headline
    ]
    notes = [
        page.text_of(fact)
        for fact in page.statements
        if fact.level is Level.NOTE and fact.quantity != DYNAMICS
    ]
    untested = []
    for axis in page.axes:
        low_V, high_V = axis.voltage_V
        slew = number(axis.certificate.slew_V_per_s, "V/s")
        name = f"Axis {axis.axis}: " if len(page.axes) > 1 else ""
        untested.append(
            f"{name}drive below {number(low_V, 'V')} or above {number(high_V, 'V')}, or faster "
            f"than {slew}; other temperature and load."
        )
    has_action = any(fact.level is Level.ACTION for fact in open_facts)
    # Axes with the same statement share a row.
    axes_of: dict[Statement, list[str]] = {}
    for fact in open_facts:
        axes_of.setdefault(replace(fact, axis="", value=None), []).append(fact.axis)
    rows = []
    for fact, names in axes_of.items():
        text = page.text_of(replace(fact, axis=names[0]))
        if len(names) > 1:
            text = f"Axes {', '.join(names)}: {fact.text}"
        rows.append((LABELS[fact.level], label_of(fact.quantity), text))
    parts: list[Part] = []
    if rows:
        parts.append(
            Table(
                caption="Limits and remedies.",
                columns=("level", "about", "statement"),
                rows=tuple(rows),
                wordy=(2,),
                is_open=True,
            )
        )
    elif not page.headline:
        parts.append(Prose(text="No limit was found that needs action.", tone="good"))
    parts += folded_listing(f"Notes: {len(notes)}", notes)
    parts += folded_listing("Conditions that were not tested", untested)
    return Section(
        anchor="limits",
        title="Limits and next experiment" if has_action else "Limits",
        lead="Conditions under which the results hold"
        + (", beyond those in the summary." if page.has_summary else "."),
        parts=tuple(parts),
    )
