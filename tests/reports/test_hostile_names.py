"""Names come from files and strangers: on the page they are text, whatever they hold."""

import unicodedata
from dataclasses import replace

import pytest

from piezoid.errors import printable
from piezoid.statement import finding
from piezoid_reports.page import Page
from piezoid_reports.render import render
from tests.reports.anatomy import Anatomy, skeleton
from tests.reports.known_stage import axis_model, recording, stage_model

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' autofocus onfocus='alert(1)",
    "</style><b>",
    "</script><b>",
    "{{ 7 * 7 }}{% raw %}",
    "--><svg onload=alert(1)>",
    "javascript:alert(1)",
    "\x00nul\x1b[31m",
    "\u202etxt.csv\u2066",
    "&lt;b&gt;",
    "\ud800half",
    "x" * 3000,
    "",
]


def _hostile_page(name: str) -> str:
    axis = replace(axis_model(name, (name,)))
    axis = replace(axis, verdict=replace(axis.verdict, remarks=(name,), reason=name))
    given = replace(
        recording(name, name, label=name),
        statements=(finding(quantity=name, place=name, text=name),),
    )
    return render(Page(model=stage_model(axis, stage=name), recordings=[given]))


@pytest.fixture(scope="module")
def tame() -> list[str]:
    """Tags and attribute names of the same page with a harmless name."""
    return skeleton(_hostile_page("harmless"))


@pytest.mark.parametrize("name", [n for n in HOSTILE if "\ud800" not in n], ids=ascii)
def test_a_hostile_name_adds_no_element_and_no_attribute(name: str, tame: list[str]) -> None:
    page = _hostile_page(name)
    assert skeleton(page) == tame
    assert [e.text for e in Anatomy(page).all("h1")] == [f"Stage {printable(name)}"]


def test_no_character_that_turns_or_breaks_a_text_reaches_the_page() -> None:
    page = _hostile_page("a\u202eb\x00c\x1bd\u2066")
    harmless = {"\n"}
    kinds = {c: unicodedata.category(c) for c in set(page)}
    assert {c for c, kind in kinds.items() if kind in {"Cc", "Cf", "Cs"}} <= harmless


def test_characters_that_turn_or_break_a_line_are_shown_as_codes() -> None:
    assert printable("a\u202eb\x00c\n\ud800") == "a\\u202eb\\x00c\\n\\ud800"
    ours = "10\u202fnm µ \N{MINUS SIGN} שלום"
    assert printable(ours) == ours
