"""params.json is read exactly as it was written, or refused."""

import hashlib
import itertools
import json
import re
from dataclasses import replace

import pytest

from piezoid.digests import seal, unseal
from piezoid.errors import ParameterFileError
from piezoid.export.parameter_file import (
    FUNCTIONS,
    AxisParameters,
    ParameterFile,
    digest_of,
    from_json,
    to_json,
)
from piezoid.runtime.schema import PARAMETERS, SCHEMA
from tests.export.stage import lateral, stage


def sealed_after(change, file=None):
    """Return a sealed file whose content was changed before it was sealed."""
    record = unseal(to_json(file or stage()), SCHEMA, "params.json")
    content = {key: value for key, value in record.items() if key not in ("schema", "digest")}
    change(content)
    return seal(SCHEMA, content)


def test_every_number_is_read_bit_for_bit():
    original = stage()
    read = from_json(to_json(original), "params.json")
    assert (read.name, read.sources) == (original.name, original.sources)
    for axis, read_axis in zip(original.axes, read.axes, strict=True):
        assert (axis.axis, axis.methods) == (read_axis.axis, read_axis.methods)
        sets = zip(
            (axis.values, *axis.alternatives),
            (read_axis.values, *read_axis.alternatives),
            strict=True,
        )
        for (first, second), parameter in itertools.product(sets, PARAMETERS):
            name = parameter.name
            assert first[name].tobytes() == second[name].tobytes(), name


def test_the_reason_of_an_unshipped_axis_is_read_and_is_optional():
    file = replace(stage(), unshipped={"z": "no ceiling > the set point"})
    assert from_json(to_json(file), "params.json").unshipped == file.unshipped
    older = sealed_after(lambda content: content.pop("unshipped"))
    assert from_json(older, "params.json").unshipped == {}


@pytest.mark.parametrize("change", ["sources", "unshipped"])
@pytest.mark.parametrize("value", [7, None, ["x"], {"a": "b"}])
def test_a_reason_or_a_digest_that_is_not_text_is_refused(change, value):
    content = sealed_after(lambda fields: fields.update({change: {"x": value}}))
    with pytest.raises(ParameterFileError, match=f"{change}.x: Expected `str`"):
        from_json(content, "params.json")


def test_a_lone_surrogate_is_refused_and_a_pair_is_read():
    halved = sealed_after(lambda fields: fields.update(name="NAME"))
    for text, match in ((rb"\ud83d", "surrogates"), (rb"\ud83d\ude00", "")):
        content = halved.replace(b"NAME", text)
        blank = re.sub(rb"sha256:[0-9a-f]{64}", b"sha256:" + b"0" * 64, content, count=1)
        content = blank.replace(b"0" * 64, hashlib.sha256(blank).hexdigest().encode(), 1)
        if match:
            with pytest.raises(ParameterFileError, match=match):
                from_json(content, "params.json")
        else:
            assert from_json(content, "params.json").name == "\U0001f600"


def test_equal_parameters_give_equal_bytes_with_units_and_meanings():
    assert to_json(stage()) == to_json(stage())
    assert to_json(from_json(to_json(stage()), "params.json")) == to_json(stage())
    record = json.loads(to_json(stage()))
    entries = record["axes"][0]["parameters"]
    assert entries["lsb_V"] == {
        "unit": "V",
        "value": 20 / 65536,
        "meaning": entries["lsb_V"]["meaning"],
    }
    assert record["axes"][0]["method"] == "mpi_dob"
    assert record["digest"] == digest_of(stage())


def test_a_changed_or_truncated_file_is_refused():
    content = bytearray(to_json(stage()))
    for offset in range(0, len(content), 7):
        content[offset] ^= 1 << (offset % 8)
        with pytest.raises(ParameterFileError):
            from_json(bytes(content), "params.json")
        content[offset] ^= 1 << (offset % 8)
    from_json(bytes(content), "params.json")
    content = to_json(stage())
    for length in (0, 1, 100, len(content) // 2, len(content) - 1):
        with pytest.raises(ParameterFileError):
            from_json(content[:length], "params.json")


def test_another_schema_version_is_refused_with_both_names():
    content = seal("piezoid.params/0", {"name": "old", "axes": []})
    with pytest.raises(ParameterFileError, match=r"piezoid\.params/0.*piezoid\.params/1"):
        from_json(content, "params.json")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda c: c["axes"][0]["parameters"].pop("lsb_V"), "lsb_V"),
        (lambda c: c["axes"][0]["parameters"]["lsb_V"].update(unit="mV"), "lsb_V"),
        (lambda c: c["axes"][0]["parameters"].update(gain={"unit": "1", "value": 1}), "gain"),
        (lambda c: c["axes"][0]["parameters"]["lsb_V"].update(value=-1.0), "lsb_V"),
        (lambda c: c["axes"][0]["parameters"]["lsb_V"].update(value="wide"), "lsb_V"),
        (lambda c: c["axes"][0]["parameters"]["knot_m"].update(value=[[1.0]]), "knot_m"),
        (lambda c: c["axes"][0]["parameters"]["gain_m_per_V"].update(value=1e-6), "observer_C"),
        (lambda c: c["axes"][0].pop("parameters"), "parameters"),
        (lambda c: c.pop("axes"), "axes"),
        (lambda c: c["axes"].clear(), "at least one axis"),
    ],
)
def test_a_sealed_file_with_other_content_is_refused(change, message):
    with pytest.raises(ParameterFileError, match=message):
        from_json(sealed_after(change), "params.json")


def test_invalid_axes_are_refused():
    axis = AxisParameters(axis="x", values=lateral("dob"))
    with pytest.raises(ParameterFileError, match="different names"):
        ParameterFile(name="twice", axes=(axis, axis))
    with pytest.raises(ParameterFileError, match="play_weight_m_per_V"):
        AxisParameters(axis="x", values={**lateral("mpi"), "play_weight_m_per_V": [0.0]})
    with pytest.raises(ParameterFileError, match="two controllers of the same method"):
        AxisParameters(axis="x", values=lateral("dob"), alternatives=(lateral("dob"),))


def test_axes_and_methods_are_selected_by_name():
    axis = stage().axis("x")
    assert axis.methods == ("mpi_dob", "mpi", "none")
    assert axis.for_method("mpi").methods == ("mpi",)
    assert stage().axis("y").with_values({"method": "none"}).method == "none"
    with pytest.raises(ParameterFileError, match="mpi_dob, mpi, none"):
        axis.for_method("dob")
    with pytest.raises(ParameterFileError, match="x, y, z"):
        stage().axis("w")


def test_a_file_without_functions_of_plays_has_none_of_their_entries():
    entries = unseal(to_json(stage()), SCHEMA, "params.json")["axes"][0]["parameters"]
    assert not FUNCTIONS & entries.keys()
    assert from_json(to_json(stage()), "params.json").axes[0].values["edge_count"] == 0


def test_functions_of_plays_are_read_and_a_missing_entry_is_refused():
    values = {
        **{"method": "mpi", "play_count": 2, "play_threshold_V": [0.0, 1.0]},
        **{"edge_count": 3, "edge_steps": 2, "edge_V": -2.0},
        "play_value_m": [[-1e-6, 0.0, 2e-6], [0.0, 0.0, 1e-6]],
    }
    axis = stage().axes[0].for_method("mpi").with_values({**values, "play_memory_V": [0.0]})
    file = ParameterFile(name="bent", axes=(axis,))
    read = from_json(to_json(file), "params.json")
    for name in FUNCTIONS:
        assert (read.axes[0].values[name] == file.axes[0].values[name]).all()
    content = sealed_after(lambda fields: fields["axes"][0]["parameters"].pop("edge_V"), file)
    with pytest.raises(ParameterFileError, match="edge_V"):
        from_json(content, "params.json")
