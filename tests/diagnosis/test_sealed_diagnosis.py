"""diagnosis.json is read only if every entry has its type."""

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
DIAGNOSIS = diagnosed(finding("creep", 0.3), finding("lag", 0.1))
DIAGNOSIS = replace(DIAGNOSIS, not_detected=DIAGNOSIS.not_detected[:2])
WRITTEN = json.loads(write_diagnosis(DIAGNOSIS))
UNCHECKED = {"schema", "digest", "unit"}


def entries(record: Any, parent: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Return the path of every entry."""
    if isinstance(record, dict):
        children = [(name, value) for name, value in record.items() if name not in UNCHECKED]
    elif isinstance(record, list):
        children = list(enumerate(record))
    else:
        return [parent]
    descendants = [path for name, value in children for path in entries(value, (*parent, name))]
    return [parent, *descendants] if parent else descendants


def type_name(value: Any) -> str:
    if isinstance(value, bool):
        return "truth"
    return "number" if isinstance(value, int | float) else type(value).__name__


def test_an_entry_of_another_type_is_refused():
    refused = 0
    for path in entries(WRITTEN):
        for replacement in WRONG:
            record = copy.deepcopy(WRITTEN)
            parent = record
            for name in path[:-1]:
                parent = parent[name]
            original, parent[path[-1]] = parent[path[-1]], replacement
            optional = ("upper_bound", "detection_limit", "unexplained", "explained_rms_m")
            is_optional = path[-1] in optional and (
                replacement is None or (original is None and type_name(replacement) == "number")
            )
            if (
                type_name(original) == type_name(replacement)
                and type_name(original) in ("str", "number", "truth")
            ) or is_optional:
                continue
            content = {name: value for name, value in record.items() if name not in UNCHECKED}
            with pytest.raises(ParameterFileError, match="with its type"):
                read_diagnoses(seal(SCHEMA, content))
            refused += 1
    assert refused > 100


def test_a_diagnosis_of_several_axes_survives_its_file():
    written = write_diagnosis(DIAGNOSIS, further_axes=(DIAGNOSIS,))
    assert read_diagnoses(written) == (DIAGNOSIS, DIAGNOSIS)


def test_an_unknown_effect_is_refused():
    unknown = replace(DIAGNOSIS.not_detected[0], effect="gremlins")
    content = write_diagnosis(replace(DIAGNOSIS, not_detected=(unknown,)))
    with pytest.raises(ParameterFileError, match="gremlins"):
        read_diagnoses(content)
