"""Summary of a record: a short table, shown as text at a prompt and as HTML in a notebook."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from piezoid.raw_counts import in_counts


@dataclass(frozen=True, kw_only=True, repr=False)
class Summary:
    """A table with a title, a row of headings and remarks.

    title     first line
    headings  of the columns; empty for a table of names and values
    rows      cells as text, one tuple per row
    notes     lines below the table
    counted   quantities in counts, a subset of ``displacement`` and ``voltage``
    """

    title: str
    headings: tuple[str, ...] = ()
    rows: Sequence[tuple[str, ...]] = ()
    notes: tuple[str, ...] = ()
    counted: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        rows = [tuple(in_counts(cell, self.counted) for cell in row) for row in self.rows]
        notes = tuple(in_counts(note, self.counted) for note in self.notes)
        object.__setattr__(self, "rows", rows)
        object.__setattr__(self, "notes", notes)

    def __str__(self) -> str:
        lines = [self.headings, *self.rows] if self.headings else list(self.rows)
        columns = max((len(cells) for cells in lines), default=0)
        widths = [max(len(cells[k]) for cells in lines) for k in range(columns)]
        table = ["  ".join(map(str.ljust, cells, widths)).rstrip() for cells in lines]
        if self.headings:
            table.insert(1, "-" * max(len(line) for line in table))
        return "\n".join((self.title, *table, *self.notes))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        style = 'style="text-align:left"'
        head = "".join(f"<th {style}>{escape(heading)}</th>" for heading in self.headings)
        body = "".join(
            "<tr>" + "".join(f"<td {style}>{escape(cell)}</td>" for cell in cells) + "</tr>"
            for cells in self.rows
        )
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return (
            f"<table><caption>{escape(self.title)}</caption>"
            f"<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>{notes}"
        )


class Summarised(ABC):
    """Base class of records with a summary at a prompt and in a notebook.

    Dataclasses that inherit from it take ``repr=False``.
    """

    @abstractmethod
    def summary(self) -> Summary:
        """Return the table for ``repr`` and notebooks."""

    def __repr__(self) -> str:
        return str(self.summary())

    def _repr_html_(self) -> str:
        return self.summary()._repr_html_()
