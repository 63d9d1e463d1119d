"""A sealed file with an entry of the wrong type is refused."""

import json
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from piezoid.design.design import design_from_json
from piezoid.errors import ParameterFileError
from piezoid.identification.store import read_model
from piezoid.verification.verification import verification_from_json
from piezoid_reports.fleet.records import stage_from_json
from tests.identification.test_sealed_models import WRITTEN
from tests.reports.test_hostile_records import corpus_file, reseal

READERS: dict[str, Callable[[bytes, str], object]] = {
    "model.json": read_model,
    "design.json": design_from_json,
    "verification.json": verification_from_json,
    "batch.json": stage_from_json,
}
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


@pytest.mark.parametrize("name", READERS)
def test_a_table_in_place_of_a_number_or_a_text_is_refused(name):
    record = (
        json.loads(json.dumps(WRITTEN)) if name == "model.json" else json.loads(corpus_file(name))
    )
    READERS[name](reseal(record), name)
    count = 0
    for holder, key in sampled_leaves(record):
        original, holder[key] = holder[key], {"x": {"y": 1}}
        with pytest.raises(ParameterFileError, match=r"with its type|exactly"):
            READERS[name](reseal(record), f"{name} {key}")
        holder[key] = original
        count += 1
    assert count > 5


def test_a_loop_without_members_or_their_margins_is_refused():
    for entry in ("members", "margins"):
        record = json.loads(corpus_file("design.json"))
        record["axes"][0]["loops"][0][entry] = []
        with pytest.raises(ParameterFileError, match="expected one of each"):
            design_from_json(reseal(record), "design.json")
