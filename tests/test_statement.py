"""Statements are selected by level and never repeated."""

from dataclasses import replace

from piezoid.statement import Kind, Level, Statement, select

NOTE = Statement(kind=Kind.LIMIT, level=Level.NOTE, quantity="range", text="No value.", axis="x")
ACTION = replace(NOTE, level=Level.ACTION, quantity="chirp", text="Record a chirp.", axis="y")


def test_statements_are_selected_by_level_and_never_repeated():
    assert select([NOTE, ACTION, NOTE]) == (ACTION, NOTE)
    assert select([NOTE, ACTION], minimum=Level.WARNING) == (ACTION,)
