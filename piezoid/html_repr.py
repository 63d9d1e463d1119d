"""HTML representation of records for notebooks: a small table of escaped text."""

from collections.abc import Collection, Sequence
from html import escape

from piezoid.raw_counts import in_counts


def html_table(
    title: str, rows: Sequence[tuple[str, str]], *, counted: Collection[str] = ()
) -> str:
    """Return a table of names and values as HTML.

    title    caption of the table
    rows     name and value, escaped
    counted  quantities in counts of a converter, of ``displacement`` and ``voltage``
    """
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(in_counts(value, counted))}</td></tr>'
        for name, value in rows
    )
    return f"<table><caption>{escape(title)}</caption><tbody>{lines}</tbody></table>"
