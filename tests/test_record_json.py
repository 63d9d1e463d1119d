"""Records are read from JSON exactly, and other JSON is refused."""

import json
from dataclasses import dataclass, replace
from enum import Enum
from math import inf
from typing import Any

import numpy as np
import pytest

from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from piezoid.numerics.arrays import Array
from piezoid.record_json import (
    Interval,
    RecordLayout,
    fields_of,
    from_fields,
    from_json,
    read_sealed,
    to_json,
)


class Grade(Enum):
    GOOD = "good"
    POOR = "poor"


@dataclass(frozen=True, kw_only=True)
class Part:
    mass_kg: float
    grade: Grade = Grade.GOOD

    @property
    def heavy(self) -> bool:
        return self.mass_kg > 1.0


@dataclass(frozen=True, kw_only=True, eq=False)
class Machine:
    name: str
    parts: tuple[Part, ...]
    speed_Hz: Interval
    curve: Array
    limits: dict[str, tuple[int, int]]
    spare: Part | None = None
    slowest_Hz: float | None = None


HEAVY = RecordLayout(kind=Part, write=lambda part: {**fields_of(part), "heavy": part.heavy})
MACHINE = Machine(
    name="mill",
    parts=(Part(mass_kg=0.1 + 0.2), Part(mass_kg=2, grade=Grade.POOR)),
    speed_Hz=(1.0, inf),
    curve=np.array([[1e-300, 0.1], [-0.0, 3.0]]),
    limits={"x": (1, 2)},
)


def through_text(value: Any) -> Any:
    return json.loads(json.dumps(value, allow_nan=False))


@pytest.mark.parametrize("layouts", [(), (HEAVY,)])
def test_a_record_is_read_to_its_last_bit(layouts):
    read = from_json(Machine, through_text(to_json(MACHINE, layouts)), layouts)
    np.testing.assert_array_equal(read.curve, MACHINE.curve)
    assert {**fields_of(read), "curve": 0} == {**fields_of(MACHINE), "curve": 0}
    assert to_json(read, layouts) == to_json(MACHINE, layouts)


def test_only_numbers_that_may_be_infinite_are_null():
    written = to_json(replace(MACHINE, slowest_Hz=inf, parts=(Part(mass_kg=inf),)))
    assert (written["speed_Hz"], written["slowest_Hz"]) == ([1.0, None], None)
    assert written["parts"][0]["mass_kg"] == inf
    assert from_json(Machine, to_json(MACHINE)).speed_Hz == (1.0, inf)


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("name", 1),
        ("name", None),
        ("parts", {}),
        ("parts", [{"mass_kg": None}]),
        ("parts", [{"mass_kg": True}]),
        ("parts", [{"mass_kg": 1.0, "grade": "fair"}]),
        ("parts", [{"mass_kg": 1.0, "colour": "red"}]),
        ("parts", [{}]),
        ("speed_Hz", [1.0]),
        ("speed_Hz", ["1", 2.0]),
        ("curve", ["a"]),
        ("limits", {"x": [1, 2.5]}),
        ("colour", "red"),
    ],
)
def test_an_entry_of_another_type_is_refused_with_the_file(entry, value):
    sealed = seal("piezoid.mill/1", {**to_json(MACHINE), entry: value})
    with pytest.raises(ParameterFileError, match=r"mill\.json.*Turn the mill"):
        read_sealed(Machine, sealed, "piezoid.mill/1", "mill.json", remedy="Turn the mill.")


def test_a_missing_entry_has_its_default():
    fields = to_json(MACHINE)
    del fields["spare"], fields["slowest_Hz"]
    assert from_fields(Machine, fields).spare is None
    del fields["name"]
    with pytest.raises(ValueError, match="the fields are"):
        from_fields(Machine, fields)
