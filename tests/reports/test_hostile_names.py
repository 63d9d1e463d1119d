"""Names from files are text on the page, whatever their characters."""

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
    hostile = replace(
        recording(name, name, label=name),
        statements=(finding(quantity=name, place=name, text=name),),
    )
    return render(Page(model=stage_model(axis, stage=name), recordings=[hostile]))


@pytest.fixture(scope="module")
def harmless_skeleton() -> list[str]:
    """Return tags and attribute names of the same page with a harmless name."""
    return skeleton(_hostile_page("harmless"))


@pytest.mark.parametrize("name", [n for n in HOSTILE if "\ud800" not in n], ids=ascii)
def test_a_hostile_name_adds_no_element_and_no_attribute(name, harmless_skeleton):
    page = _hostile_page(name)
    assert skeleton(page) == harmless_skeleton
    assert [e.text for e in Anatomy(page).all("h1")] == [f"Stage {printable(name)}"]


def test_control_characters_are_escaped():
    page = _hostile_page("a\u202eb\x00c\x1bd\u2066")
    harmless = {"\n"}
    categories = {c: unicodedata.category(c) for c in set(page)}
    assert {c for c, kind in categories.items() if kind in {"Cc", "Cf", "Cs"}} <= harmless
    assert printable("a\u202eb\x00c\n\ud800") == "a\\u202eb\\x00c\\n\\ud800"
    text = "10\u202fnm µ \N{MINUS SIGN} שלום"
    assert printable(text) == text
