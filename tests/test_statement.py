"""Statements are selected by axis and level and never repeated."""

from dataclasses import replace

from piezoid.statement import Kind, Level, Statement, select

NOTE = Statement(kind=Kind.LIMIT, level=Level.NOTE, quantity="range", text="No value.", axis="x")
ACTION = replace(NOTE, level=Level.ACTION, quantity="chirp", text="Record a chirp.", axis="y")


def test_the_most_important_statement_comes_first_and_none_is_repeated() -> None:
    assert select([NOTE, ACTION, NOTE]) == (ACTION, NOTE)


def test_statements_are_selected_by_axis_and_level() -> None:
    assert select([NOTE, ACTION], axis="x") == (NOTE,)
    assert select([NOTE, ACTION], minimum=Level.WARNING) == (ACTION,)


def test_a_value_is_formatted_with_a_prefix_and_its_absence_with_nothing() -> None:
    assert replace(NOTE, value=3e-9, unit="m").formatted_value == "3.00 nm"
    assert NOTE.formatted_value == ""
