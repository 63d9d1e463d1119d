"""Every text of a model, a design, a verification, a batch: on the page it is text."""

import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from piezoid.design.design import design_from_json
from piezoid.digests import seal
from piezoid.errors import PiezoidError
from piezoid.identification.store import read_model, write_model
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import Fleet, FleetStage, stage_from_json
from piezoid_reports.fleet.sections import render_fleet
from piezoid_reports.page import Page
from piezoid_reports.render import render, render_design
from tests.reports.anatomy import skeleton
from tests.reports.known_stage import axis_model, recording, stage_model
from tests.reports.test_hostile_names import HOSTILE

KEPT = Path(__file__).parents[1] / "records" / "corpus.zip"


def _kept(name: str) -> bytes:
    with zipfile.ZipFile(KEPT) as archive:
        return archive.read(f"{name}/first")


def _fleet(stage: FleetStage) -> str:
    return render_fleet(Fleet(name="night", stages=(stage,) * 8))


# how each file is read, and what is drawn of it
PAGES: dict[str, tuple[Callable[[bytes], Any], Callable[[Any], str]]] = {
    # an axis of another name is read, and refused beside this recording
    "model.json": (
        lambda content: render(Page(model=read_model(content), recordings=[recording()])),
        str,
    ),
    "design.json": (
        design_from_json,
        lambda design: render_design(stage_model(axis_model()), design),
    ),
    "verification.json": (
        verification_from_json,
        lambda verification: render(
            Page(
                model=stage_model(axis_model()),
                recordings=[recording()],
                verification=verification,
            )
        ),
    ),
    "batch.json": (lambda content: stage_from_json(content, "batch.json"), _fleet),
}


def _places(record: Any) -> Iterator[tuple[Any, Any]]:
    """Return every text of a record by the list or table that holds it."""
    items = record.items() if isinstance(record, dict) else enumerate(record)
    for key, value in list(items):
        if isinstance(value, dict | list):
            yield from _places(value)
        elif isinstance(value, str) and key not in ("schema", "digest"):
            yield record, key


def _sealed(record: dict[str, Any]) -> bytes:
    held = {key: value for key, value in record.items() if key not in ("schema", "digest")}
    return seal(record["schema"], held)


def _is_read(record: dict[str, Any], read: Callable[[bytes], Any]) -> bool:
    """Whether it is taken for such a file."""
    try:
        read(_sealed(record))
    except PiezoidError:
        return False
    return True


@pytest.mark.parametrize("name", PAGES)
def test_no_text_of_a_sealed_file_adds_an_element_or_an_attribute(name: str) -> None:
    first = _kept(name) if name != "model.json" else write_model(stage_model(axis_model()))
    record = json.loads(first)
    read, drawn = PAGES[name]
    free = []
    for holder, key in _places(record):
        before, holder[key] = holder[key], "harmless"
        if _is_read(record, read):
            free.append((holder, key))
        else:
            holder[key] = before
    assert len(free) > 3
    tame = drawn(read(_sealed(record)))
    for hostile in HOSTILE[:6]:  # test_hostile_names.py shows all of them
        for holder, key in free:
            holder[key] = hostile
        page = drawn(read(_sealed(record)))
        assert skeleton(page) == skeleton(tame)
