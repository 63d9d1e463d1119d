"""model.json is read only if every entry has its type."""

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
from tests.identification.extended_stage import known_model, recordings_of
from tests.identification.extensions.samples import one_of_each
from tests.reports.known_stage import axis_model, stage_model

WRITTEN = json.loads(write_model(stage_model(axis_model())))


def with_entry(path: str, value: Any) -> bytes:
    """Return the sealed model with one entry replaced."""
    record = json.loads(json.dumps(WRITTEN))
    *parents, key = path.split()
    parent = record
    for name in parents:
        parent = parent[name]
    assert key in parent
    parent[key] = value
    return sealed(record)


def sealed(record: dict[str, Any]) -> bytes:
    content = {key: value for key, value in record.items() if key not in ("schema", "digest")}
    return seal(SCHEMA, content)


@pytest.mark.parametrize(
    ("entry", "value", "message"),
    [
        ("play_weight_m_per_V", [1e-7] * 50_000, "has 50000 entries. Needed: at most 256"),
        ("dead_zone_weight", [1.0] * 1_000_000, "has 1000000 entries. Needed: at most 256"),
        ("play_weight_m_per_V", [1e308, 1e308], "holds 1e\\+308. Needed: at most 1e\\+12"),
        ("displacement_offset_m", -1e308, "holds 1e\\+308"),
        ("play_weight_m_per_V", [0.0, 0.0], "all play_weight_m_per_V are 0"),
    ],
)
def test_counts_and_magnitudes_beyond_their_bounds_are_refused(entry, value, message):
    with pytest.raises(ParameterFileError, match=message):
        read_model(with_entry(f"axes x hysteresis {entry}", value))


@pytest.mark.parametrize(
    ("path", "value"),
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
def test_an_impossible_number_is_refused(path, value):
    with pytest.raises(ParameterFileError, match="with its type"):
        read_model(with_entry(path, value))


def test_an_axis_under_another_name_is_refused():
    with pytest.raises(ParameterFileError, match="axis 'tip' is stored under 'x'"):
        read_model(with_entry("axes x axis", "tip"))


def test_an_integer_is_accepted_for_a_measured_number():
    model = read_model(with_entry("axes x lag time_s", 0))
    assert write_model(read_model(write_model(model))) == write_model(model)


@pytest.mark.parametrize("number", ["NaN", "-Infinity", "1e999"])
def test_a_sealed_number_that_is_not_finite_is_refused(number):
    blank = f'{{"schema": "{SCHEMA}", "digest": "sha256:{"0" * 64}", "stage": {number}}}'.encode()
    digest = hashlib.sha256(blank).hexdigest().encode()
    with pytest.raises(ParameterFileError, match="JSON text"):
        read_model(blank.replace(b"0" * 64, digest, 1))


def test_extensions_survive_their_file_and_simulate_the_same_bits():
    extended = known_model(*one_of_each())
    restored = read_model(write_model(stage_model(extended)))["x"]
    assert restored.extensions == extended.extensions
    recording = recordings_of()[0]
    np.testing.assert_array_equal(
        simulate_recording(restored, recording), simulate_recording(extended, recording)
    )


def test_a_file_without_extensions_gives_a_model_without_extensions():
    content = json.loads(write_model(stage_model(known_model())))
    del content["axes"]["x"]["extensions"]
    assert read_model(sealed(content))["x"].extensions == ()


def test_an_unphysical_extension_is_refused_with_its_number():
    content = json.loads(write_model(stage_model(known_model())))
    content["axes"]["x"]["extensions"] = [{"kind": "first_order_lag", "lag_s": -1.0}]
    with pytest.raises(ParameterFileError, match=re.escape("lag_s is -1.0")):
        read_model(sealed(content))
