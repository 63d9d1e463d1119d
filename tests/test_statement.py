"""Statements are selected by level and never repeated."""

from dataclasses import replace

from piezoid.statement import Kind, Level, Statement, select

NOTE = Statement(kind=Kind.LIMIT, level=Level.NOTE, quantity="range", text="No value.", axis="x")
ACTION = replace(NOTE, level=Level.ACTION, quantity="chirp", text="Record a chirp.", axis="y")


def test_the_most_important_statement_comes_first_and_none_is_repeated() -> None:
    assert select([NOTE, ACTION, NOTE]) == (ACTION, NOTE)


def test_statements_are_selected_by_level() -> None:
    assert select([NOTE, ACTION], minimum=Level.WARNING) == (ACTION,)
