"""Every sealed file comes back as the record that wrote it, and writes the same bytes again."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import piezoid
from piezoid.diagnosis.sealed_diagnosis import write_diagnosis
from piezoid.errors import ParameterFileError, RecordingError
from piezoid.sealed_files import sealed
from tests.reports.known_diagnosis import diagnosed, finding
from tests.verification.known_fit import fitted
from tests.verification.rig import RATE_Hz

LAB_TOML = """
[sensor]
gain_V_per_m = 2e5
[acquisition]
dac_bits = 16
adc_bits = 16
input_range_V = [-10, 10]
"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory) -> Path:
    place = tmp_path_factory.mktemp("rig") / "lab.toml"
    place.write_text(LAB_TOML)
    return place


@pytest.fixture(scope="module")
def design(lab) -> piezoid.Design:
    return piezoid.design(fitted(), lab=lab, sampling_rate_Hz=RATE_Hz)


@pytest.fixture(scope="module")
def shipping(lab, design) -> piezoid.Shipping:
    return piezoid.export(fitted(), design, lab=str(lab))


def diagnosis(axis: str) -> piezoid.Diagnosis:
    return replace(diagnosed(finding("creep")), axis=axis)


def test_every_sealed_file_writes_the_same_bytes_again(design, shipping, tmp_path) -> None:
    records = {
        "model.json": fitted(),
        "design.json": design,
        "params.json": shipping.parameters,
        "verification.json": shipping.verification,
    }
    for name, record in records.items():
        piezoid.save(record, tmp_path / name)
        again = piezoid.load(tmp_path / name)
        assert type(again) is type(record)
        piezoid.save(again, tmp_path / "again.json")
        assert (tmp_path / "again.json").read_bytes() == (tmp_path / name).read_bytes()
    assert isinstance(piezoid.load(str(tmp_path)), piezoid.ActuatorModel)


def test_diagnoses_come_back_one_for_each_axis(tmp_path) -> None:
    place = tmp_path / "diagnosis.json"
    piezoid.save(diagnosis("x"), place)
    assert piezoid.load(place) == (diagnosis("x"),)
    piezoid.save([diagnosis("x"), diagnosis("y")], place)
    assert piezoid.load(place) == (diagnosis("x"), diagnosis("y"))
    assert place.read_bytes() == write_diagnosis(diagnosis("x"), further_axes=[diagnosis("y")])


def test_what_ships_is_verified_again_to_the_same_bytes(lab, shipping) -> None:
    assert shipping.verification.passed
    again = piezoid.verify(shipping, fitted(), lab=lab)
    assert again.to_json() == shipping.verification.to_json()


def test_a_design_of_another_model_is_not_exported(lab, design) -> None:
    other = fitted().with_axis(fitted()["x"])
    assert piezoid.export(other, design, lab=lab).parameters is not None  # the same numbers
    renamed = piezoid.ActuatorModel(stage="other", axes=other.axes, sources={})
    with pytest.raises(ParameterFileError, match="was made from the model"):
        piezoid.export(renamed, design, lab=lab)


def test_the_report_is_drawn_from_records_alone(lab, design, shipping) -> None:
    page = piezoid.report(fitted(), design=design, shipping=shipping, lab=lab)
    assert page.startswith("<!doctype html>") or page.lower().startswith("<!doctype html")
    assert shipping.verification.parameters_digest[:19] in page


@pytest.mark.parametrize(
    "content",
    [b"", b"[]", b'"model"', b'{"schema": "piezoid.summary/1"}', b"\xff\xfe", b"[" * 5000],
)
def test_a_file_that_is_none_of_ours_is_refused(tmp_path, content: bytes) -> None:
    (tmp_path / "odd.json").write_bytes(content)
    with pytest.raises(ParameterFileError, match=r"odd\.json has"):
        piezoid.load(tmp_path / "odd.json")


def test_a_changed_digit_is_refused(tmp_path) -> None:
    record = json.loads(sealed(fitted()))
    record["stage"] = "somebody else's"
    (tmp_path / "model.json").write_text(json.dumps(record))
    with pytest.raises(ParameterFileError):
        piezoid.load(tmp_path)


@pytest.mark.parametrize("given", [3, None, [], "model.json", object()])
def test_what_has_no_file_is_not_saved(tmp_path, given) -> None:
    with pytest.raises(ParameterFileError, match="has no sealed file"):
        piezoid.save(given, tmp_path / "x.json")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("given", [3, "sweep.csv", ["sweep.csv"], None, {"a": 1}])
def test_what_is_no_recording_is_refused_in_words(given) -> None:
    with pytest.raises(RecordingError, match="given as a recording"):
        piezoid.fit(given)


def test_reading_nothing_is_refused() -> None:
    with pytest.raises(RecordingError, match="no file is given"):
        piezoid.read()
    with pytest.raises(RecordingError, match="int given as a path"):
        piezoid.read(3)  # type: ignore[arg-type]
