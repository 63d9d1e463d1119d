"""Names and texts from files are text on the page, and sealed files of other types are refused."""

import json
import unicodedata
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from piezoid.design.design import design_from_json
from piezoid.digests import digest_of_bytes, seal
from piezoid.errors import ParameterFileError, PiezoidError, printable
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.store import read_model, write_model
from piezoid.statement import finding
from piezoid.summary import Summary
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import Fleet, FleetStage, stage_from_json
from piezoid_reports.fleet.sections import render_fleet
from piezoid_reports.page import Page
from piezoid_reports.render import render, render_design
from tests.identification.test_sealed_models import WRITTEN
from tests.reports.anatomy import Anatomy, skeleton
from tests.reports.known_page import page_of
from tests.reports.known_stage import axis_model, recording, stage_model

CORPUS = Path(__file__).parents[1] / "records" / "corpus.zip"
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


def test_a_notebook_shows_numbers_and_no_markup_of_names():
    table = Anatomy(recording()._repr_html_())
    assert "500 Hz" in table.all("table")[0].text
    assert digest_of_bytes(b"")[:7] in table.all("table")[0].text
    assert "30.0 nm rms" in stage_model(axis_model())._repr_html_()
    refused = stage_model(axis_model(reason="it turns back"))
    assert "does not apply: it turns back" in refused._repr_html_()
    hostile = replace(recording(), name="<script>alert(1)</script>.csv")
    assert "<script" not in hostile._repr_html_()
    table = Summary(title="<b>", headings=("<b>",), rows=[("<b>",)], notes=("<b>",))
    assert "<b>" not in table._repr_html_()


def corpus_file(name: str) -> bytes:
    with zipfile.ZipFile(CORPUS) as archive:
        return archive.read(f"{name}/first")


def _fleet(stage: FleetStage) -> str:
    return render_fleet(Fleet(name="night", stages=(stage,) * 8))


def _model_of_recording(content: bytes) -> ActuatorModel:
    """Read a model; one whose axis has another name is refused with the recording."""
    model = read_model(content)
    recording().displacement_m(model["x"].axis)
    return model


# The reader of each file, and the page of its record.
PAGES: dict[str, tuple[Callable[[bytes], Any], Callable[[Any], str]]] = {
    "model.json": (
        _model_of_recording,
        lambda model: render(Page(model=model, recordings=[recording()])),
    ),
    "design.json": (
        design_from_json,
        lambda design: render_design(stage_model(axis_model()), design),
    ),
    "verification.json": (
        verification_from_json,
        lambda verification: page_of(axis_model(), verification=verification),
    ),
    "batch.json": (lambda content: stage_from_json(content, "batch.json"), _fleet),
}


def texts_of(record: Any) -> Iterator[tuple[Any, Any]]:
    """Return the container and the key of every text of a record."""
    items = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in list(items):
        if isinstance(value, dict | list):
            yield from texts_of(value)
        elif isinstance(value, str) and key not in ("schema", "digest"):
            yield record, key


def reseal(record: dict[str, Any]) -> bytes:
    fields = {key: value for key, value in record.items() if key not in ("schema", "digest")}
    return seal(record["schema"], fields)


def _is_read(record: dict[str, Any], read: Callable[[bytes], Any]) -> bool:
    """Tell whether the record is accepted as such a file."""
    try:
        read(reseal(record))
    except PiezoidError:
        return False
    return True


@pytest.mark.parametrize("name", PAGES)
def test_no_text_of_a_sealed_file_adds_an_element_or_an_attribute(name):
    content = corpus_file(name) if name != "model.json" else write_model(stage_model(axis_model()))
    record = json.loads(content)
    read, draw = PAGES[name]
    free_texts = []
    for holder, key in texts_of(record):
        original, holder[key] = holder[key], "harmless"
        if _is_read(record, read):
            free_texts.append((holder, key))
        else:
            holder[key] = original
    assert len(free_texts) > 3
    harmless = draw(read(reseal(record)))
    for holder, key in free_texts:
        holder[key] = "".join(HOSTILE[:6])  # names have each of them alone
    assert skeleton(draw(read(reseal(record)))) == skeleton(harmless)


# Entries for people and other programs, which are computed again or have free names.
UNREAD = {"schema", "digest", "passed", "gauge", "held_out_rms_percent", "explained_rms_m"}


def sampled_leaves(record: Any) -> Iterator[tuple[Any, Any]]:
    """Return the first and last entry of every list and all entries of a table."""
    items = list(record.items() if isinstance(record, dict) else enumerate(record))
    for key, value in items if isinstance(record, dict) else items[:1] + items[1:][-1:]:
        if isinstance(value, dict | list) and value:
            yield from sampled_leaves(value)
        elif key not in UNREAD:
            yield record, key


@pytest.mark.parametrize("name", PAGES)
def test_a_table_in_place_of_a_number_or_a_text_is_refused(name):
    record = (
        json.loads(json.dumps(WRITTEN)) if name == "model.json" else json.loads(corpus_file(name))
    )
    read, _ = PAGES[name]
    read(reseal(record))
    count = 0
    for holder, key in sampled_leaves(record):
        original, holder[key] = holder[key], {"x": {"y": 1}}
        with pytest.raises(ParameterFileError, match=r"with its type|exactly"):
            read(reseal(record))
        holder[key] = original
        count += 1
    assert count > 5


def test_a_loop_without_members_or_their_margins_is_refused():
    for entry in ("members", "margins"):
        record = json.loads(corpus_file("design.json"))
        record["axes"][0]["loops"][0][entry] = []
        with pytest.raises(ParameterFileError, match="expected one of each"):
            design_from_json(reseal(record), "design.json")
