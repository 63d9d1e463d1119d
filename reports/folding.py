"""What stands open and what a reader opens: of many recordings, the one fitted worst."""

from collections.abc import Iterator, Sequence

from piezoid_reports.page import Figure, Fold, Part


def first_open(drawn: Sequence[tuple[Figure, ...]], *, shown: int = 0) -> list[Part]:
    """Return the figures of the first recording, all others in one fold.

    drawn  figures of each recording, worst fitted first
    shown  how many of the first recording's stand open; 0 for all
    """
    if not drawn:
        return []
    open_ones = drawn[0][: shown or len(drawn[0])]
    rest = (*drawn[0][len(open_ones) :], *(one for figures in drawn[1:] for one in figures))
    if not rest:
        return list(open_ones)
    count = len(drawn) - 1
    more = {0: "", 1: ", 1 further recording"}.get(count, f", {count} further recordings")
    plural = "1 figure" if len(rest) == 1 else f"{len(rest)} figures"
    return [*open_ones, Fold(summary=f"More of it{more}: {plural}", parts=rest)]


def figures_in(parts: Sequence[Part]) -> Iterator[Figure]:
    """Yield every figure, those in folds as well."""
    for part in parts:
        if isinstance(part, Figure):
            yield part
        elif isinstance(part, Fold):
            yield from figures_in(part.parts)
