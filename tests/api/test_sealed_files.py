"""Every sealed file is read as its record, which writes the same bytes again."""

import json
from dataclasses import replace

import pytest

import piezoid
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.sealed_files import sealed
from tests.design.designed import known_design, known_shipping
from tests.reports.known_diagnosis import diagnosed, finding
from tests.verification.known_fit import fitted


def diagnosis(axis: str) -> piezoid.Diagnosis:
    return replace(diagnosed(finding("creep")), axis=axis)


def test_every_sealed_file_writes_the_same_bytes_again(tmp_path):
    records = {
        "model.json": fitted(),
        "design.json": known_design(),
        "params.json": known_shipping().parameters,
        "verification.json": known_shipping().verification,
    }
    for name, record in records.items():
        piezoid.save(record, tmp_path / name)
        read = piezoid.load(tmp_path / name)
        assert type(read) is type(record)
        piezoid.save(read, tmp_path / "again.json")
        assert (tmp_path / "again.json").read_bytes() == (tmp_path / name).read_bytes()
    assert isinstance(piezoid.load(str(tmp_path)), piezoid.ActuatorModel)


def test_diagnoses_are_read_for_each_axis(tmp_path):
    path = tmp_path / "diagnosis.json"
    piezoid.save(diagnosis("x"), path)
    assert piezoid.load(path) == (diagnosis("x"),)
    piezoid.save([diagnosis("x"), diagnosis("y")], path)
    assert piezoid.load(path) == (diagnosis("x"), diagnosis("y"))
    assert path.read_bytes() == write_diagnosis(diagnosis("x"), further_axes=[diagnosis("y")])


def test_a_repeated_verification_has_the_same_bytes():
    """A model with the same numbers is the same model."""
    verification = known_shipping().verification
    assert verification.passed
    copied = fitted().with_axis(fitted()["x"])
    repeated = piezoid.verify(known_shipping(), copied)
    assert repeated.to_json() == verification.to_json()


def test_a_design_of_another_model_is_not_exported():
    renamed = piezoid.ActuatorModel(stage="other", axes=fitted().axes, sources={})
    with pytest.raises(ParameterFileError, match="was made from the model"):
        piezoid.export(renamed, known_design())


def test_the_report_needs_records_only():
    page = piezoid.report(fitted(), design=known_design(), shipping=known_shipping())
    assert page.lower().startswith("<!doctype html")
    assert known_shipping().verification.parameters_digest[:19] in page


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b'"model"', b'{"schema": "piezoid.summary/1"}', b"\xff\xfe", b"[" * 5000],
)
def test_an_unknown_file_is_refused(tmp_path, content):
    (tmp_path / "odd.json").write_bytes(content)
    with pytest.raises(ParameterFileError, match=r"odd\.json has"):
        piezoid.load(tmp_path / "odd.json")


def test_a_changed_digit_is_refused(tmp_path):
    record = json.loads(sealed(fitted()))
    record["stage"] = "somebody else's"
    (tmp_path / "model.json").write_text(json.dumps(record))
    with pytest.raises(ParameterFileError):
        piezoid.load(tmp_path)


@pytest.mark.parametrize("value", [3, None, [], "model.json", object()])
def test_a_value_without_a_file_format_is_not_saved(tmp_path, value):
    with pytest.raises(ParameterFileError, match="has no sealed file"):
        piezoid.save(value, tmp_path / "x.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("value", [3, "sweep.csv", ["sweep.csv"], None, {"a": 1}])
def test_a_value_that_is_no_recording_is_refused(value):
    with pytest.raises(RecordingError, match="given as a recording"):
        piezoid.fit(value)


def test_reading_nothing_is_refused():
    with pytest.raises(RecordingError, match="no file is given"):
        piezoid.read()
    with pytest.raises(RecordingError, match="int given as a path"):
        piezoid.read(3)  # type: ignore[arg-type]
