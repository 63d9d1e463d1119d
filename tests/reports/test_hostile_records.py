"""Every text of a model, a design, a verification and a batch is text on the page."""

import json
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from piezoid.design.design import design_from_json
from piezoid.digests import seal
from piezoid.errors import PiezoidError
from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.store import read_model, write_model
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import Fleet, FleetStage, stage_from_json
from piezoid_reports.fleet.sections import render_fleet
from piezoid_reports.page import Page
from piezoid_reports.render import render, render_design
from tests.reports.anatomy import skeleton
from tests.reports.known_stage import axis_model, recording, stage_model
from tests.reports.test_hostile_names import HOSTILE

CORPUS = Path(__file__).parents[1] / "records" / "corpus.zip"


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
        holder[key] = "".join(HOSTILE[:6])  # test_hostile_names.py has each of them alone
    assert skeleton(draw(read(reseal(record)))) == skeleton(harmless)
