"""How a record shows itself in a notebook: a small table of texts, in which no name is markup."""

from collections.abc import Sequence
from html import escape


def shown(title: str, rows: Sequence[tuple[str, str]]) -> str:
    """Return a record as HTML.

    title  what it is
    rows   name and value, both shown as text
    """
    lines = "".join(
        f'<tr><th style="text-align:left">{escape(name)}</th>'
        f'<td style="text-align:left">{escape(value)}</td></tr>'
        for name, value in rows
    )
    return f"<table><caption>{escape(title)}</caption><tbody>{lines}</tbody></table>"
