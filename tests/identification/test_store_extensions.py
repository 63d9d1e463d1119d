"""model.json holds extensions, and files of before there were any still load."""

import json
import re

import numpy as np
import pytest

from piezoid.digests import seal
from piezoid.errors import ParameterFileError
from piezoid.identification.simulation import simulate_recording
from piezoid.identification.store import SCHEMA, read_model, write_model
from tests.identification.extensions.samples import one_of_each
from tests.identification.joint.stage import known_model, recordings_of
from tests.reports.known_stage import stage_model


def test_extensions_come_back_and_simulate_the_same_bits() -> None:
    extended = known_model(*one_of_each())
    again = read_model(write_model(stage_model(extended)))["x"]
    assert again.extensions == extended.extensions
    given = recordings_of()[0]
    np.testing.assert_array_equal(
        simulate_recording(again, given), simulate_recording(extended, given)
    )


def test_a_file_without_the_entry_is_a_model_without_extensions() -> None:
    content = json.loads(write_model(stage_model(known_model())))
    del content["axes"]["x"]["extensions"]
    assert read_model(_sealed(content))["x"].extensions == ()


def test_an_unphysical_extension_is_refused_with_its_number() -> None:
    content = json.loads(write_model(stage_model(known_model())))
    content["axes"]["x"]["extensions"] = [{"kind": "first_order_lag", "lag_s": -1.0}]
    with pytest.raises(ParameterFileError, match=re.escape("lag_s is -1.0")):
        read_model(_sealed(content))


def _sealed(content: dict[str, object]) -> bytes:
    rest = {name: value for name, value in content.items() if name not in ("schema", "digest")}
    return seal(SCHEMA, rest)
