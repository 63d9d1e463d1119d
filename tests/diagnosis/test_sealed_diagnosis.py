"""diagnosis.json is taken only as it could have been written: every entry with its type."""

import copy
import json
from dataclasses import replace
from typing import Any

import pytest

from piezoid.diagnosis.sealed_diagnosis import SCHEMA, read_diagnoses, write_diagnosis
from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from tests.reports.known_diagnosis import diagnosed, finding

WRONG: tuple[Any, ...] = ("x", [[]], {"x": []}, True, None, 7.5)
KNOWN = diagnosed(finding("creep", 0.3), finding("lag", 0.1))
KNOWN = replace(KNOWN, not_detected=KNOWN.not_detected[:2])
WRITTEN = json.loads(write_diagnosis(KNOWN))
NOT_READ = {"schema", "digest", "unit"}


def entries(record: Any, above: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the way to every entry."""
    if isinstance(record, dict):
        ways = [(name, held) for name, held in record.items() if name not in NOT_READ]
    elif isinstance(record, list):
        ways = list(enumerate(record))
    else:
        return [above]
    deeper = [way for name, held in ways for way in entries(held, (*above, name))]
    return [above, *deeper] if above else deeper


def kind(value: Any) -> str:
    if isinstance(value, bool):
        return "truth"
    return "number" if isinstance(value, int | float) else type(value).__name__


def test_an_entry_of_another_kind_is_refused():
    tried = 0
    for way in entries(WRITTEN):
        for wrong in WRONG:
            record = copy.deepcopy(WRITTEN)
            holder = record
            for name in way[:-1]:
                holder = holder[name]
            was, holder[way[-1]] = holder[way[-1]], wrong
            optional = ("upper_bound", "detection_limit", "unexplained", "explained_rms_m")
            may_be_none = way[-1] in optional and (
                wrong is None or (was is None and kind(wrong) == "number")
            )
            if (
                kind(was) == kind(wrong) and kind(was) in ("str", "number", "truth")
            ) or may_be_none:
                continue
            content = {name: held for name, held in record.items() if name not in NOT_READ}
            with pytest.raises(ParameterFileError, match="with its type"):
                read_diagnoses(seal(SCHEMA, content))
            tried += 1
    assert tried > 100


def test_what_was_written_is_read_back_the_same_for_every_axis():
    assert read_diagnoses(write_diagnosis(KNOWN, further_axes=(KNOWN,))) == (KNOWN, KNOWN)


def test_an_effect_that_nobody_knows_is_refused():
    strange = replace(KNOWN.not_detected[0], effect="gremlins")
    content = write_diagnosis(replace(KNOWN, not_detected=(strange,)))
    with pytest.raises(ParameterFileError, match="gremlins"):
        read_diagnoses(content)
