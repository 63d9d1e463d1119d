"""model.json is taken only as it could have been written: every entry with its type."""

import hashlib
import json
import re
from typing import Any

import numpy as np
import pytest

from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from piezoid.identification.model import SCHEMA
from piezoid.identification.simulation import simulate_recording
from piezoid.identification.store import read_model, write_model
from tests.identification.extensions.samples import one_of_each
from tests.identification.joint.stage import known_model, recordings_of
from tests.reports.known_stage import axis_model, stage_model

WRITTEN = json.loads(write_model(stage_model(axis_model())))
WRONG: dict[str, Any] = {"a text": "x", "a list": [1], "a table": {"x": 1}, "truth": True}
KINDS = {
    "stage": ("a list", "a table", "truth"),
    "sources": ("a text", "a list", "truth"),
    "remarks": ("a text", "a table", "truth"),
    "controller_rate_Hz": tuple(WRONG),
    "axes x axis": ("a list", "a table", "truth"),
    "axes x polarity": tuple(WRONG),
    "axes x hysteresis voltage_offset_V": tuple(WRONG),
    "axes x lag": ("a text", "a list", "truth"),
    "axes x lag time_s": tuple(WRONG),
    "axes x rig amplifier_bandwidth_Hz": tuple(WRONG),
    "axes x verdict applies": ("a text", "a list", "a table"),
    "axes x verdict remarks": ("a text", "a table", "truth"),
    "axes x valid_range voltage_V": tuple(WRONG),
    "axes x quality rms_m": tuple(WRONG),
    "axes x quality range_m": tuple(WRONG),
    "axes x quality orders": tuple(WRONG),
    "axes x quality held_out_kind": ("a list", "a table", "truth"),
    "axes x uncertainty blocks": tuple(WRONG),
    "axes x uncertainty names": ("a text", "a table", "truth"),
    "axes x uncertainty upper_limit": ("a text", "a list", "truth"),
    "axes x uncertainty loop_width_m": tuple(WRONG),
    "axes x certificate plays_m": tuple(WRONG),
}


def with_entry(place: str, value: Any) -> bytes:
    """The model, sealed with one entry replaced."""
    record = json.loads(json.dumps(WRITTEN))
    *above, last = place.split()
    holder = record
    for name in above:
        holder = holder[name]
    assert last in holder
    holder[last] = value
    return sealed(record)


def sealed(record: dict[str, Any]) -> bytes:
    content = {key: held for key, held in record.items() if key not in ("schema", "digest")}
    return seal(SCHEMA, content)


@pytest.mark.parametrize("place", KINDS)
def test_an_entry_of_another_kind_is_refused(place):
    for kind in KINDS[place]:
        with pytest.raises(ParameterFileError, match="with its type"):
            read_model(with_entry(place, WRONG[kind]))


@pytest.mark.parametrize(
    ("entry", "value", "said"),
    [
        ("play_weight_m_per_V", [1e-7] * 50_000, "has 50000 entries. Needed: at most 256"),
        ("dead_zone_weight", [1.0] * 1_000_000, "has 1000000 entries. Needed: at most 256"),
        ("play_weight_m_per_V", [1e308, 1e308], "holds 1e\\+308. Needed: at most 1e\\+12"),
        ("displacement_offset_m", -1e308, "holds 1e\\+308"),
        ("play_weight_m_per_V", [0.0, 0.0], "all play_weight_m_per_V are 0"),
    ],
)
def test_counts_and_magnitudes_beyond_their_bounds_are_refused_with_number_and_bound(
    entry, value, said
):
    with pytest.raises(ParameterFileError, match=said):
        read_model(with_entry(f"axes x hysteresis {entry}", value))


@pytest.mark.parametrize(
    ("place", "value"),
    [
        ("axes x polarity", 0),
        ("axes x polarity", 2),
        ("axes x quality rms_m", -1e-9),
        ("axes x quality held_out_rms_m", -1e-30),
        ("axes x quality range_m", -1e-6),
        ("axes x quality noise_rms_m", -1e-9),
        ("axes x uncertainty values", []),
        ("axes x uncertainty names", []),
    ],
)
def test_a_number_that_no_fit_finds_is_refused(place, value):
    with pytest.raises(ParameterFileError, match="with its type"):
        read_model(with_entry(place, value))


def test_a_whole_number_stands_for_a_measured_one_and_comes_back():
    model = read_model(with_entry("axes x lag time_s", 0))
    assert write_model(read_model(write_model(model))) == write_model(model)


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999"])
def test_a_sealed_number_that_is_none_is_refused(number):
    blank = f'{{"schema": "{SCHEMA}", "digest": "sha256:{"0" * 64}", "stage": {number}}}'.encode()
    digest = hashlib.sha256(blank).hexdigest().encode()
    with pytest.raises(ParameterFileError, match="JSON text"):
        read_model(blank.replace(b"0" * 64, digest, 1))


def test_extensions_come_back_and_simulate_the_same_bits():
    extended = known_model(*one_of_each())
    again = read_model(write_model(stage_model(extended)))["x"]
    assert again.extensions == extended.extensions
    given = recordings_of()[0]
    np.testing.assert_array_equal(
        simulate_recording(again, given), simulate_recording(extended, given)
    )


def test_a_file_without_the_entry_is_a_model_without_extensions():
    content = json.loads(write_model(stage_model(known_model())))
    del content["axes"]["x"]["extensions"]
    assert read_model(sealed(content))["x"].extensions == ()


def test_an_unphysical_extension_is_refused_with_its_number():
    content = json.loads(write_model(stage_model(known_model())))
    content["axes"]["x"]["extensions"] = [{"kind": "first_order_lag", "lag_s": -1.0}]
    with pytest.raises(ParameterFileError, match=re.escape("lag_s is -1.0")):
        read_model(sealed(content))
