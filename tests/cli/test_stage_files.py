"""The files of a stage are read whole, and only where they can be such files."""

import os
from pathlib import Path

import pytest

from piezoid.errors import LabFileError, ParameterFileError
from piezoid_cli.init import init
from piezoid_cli.stage_files import content_of, text_of


def test_a_pipe_in_the_place_of_a_sealed_file_is_refused_and_not_waited_for(
    tmp_path: Path,
) -> None:
    os.mkfifo(tmp_path / "model.json")
    (tmp_path / "params.json").symlink_to("/dev/zero")
    for name in ("model.json", "params.json"):
        with pytest.raises(OSError, match="a pipe or a device"):
            content_of(tmp_path / name)


def test_a_file_larger_than_any_of_ours_is_refused_by_its_size(tmp_path: Path) -> None:
    """It has holes and takes no disk; a gigabyte is read by nobody."""
    place = tmp_path / "model.json"
    place.write_bytes(b"x" * 100)
    assert content_of(place) == b"x" * 100
    os.truncate(place, 1 << 27)
    assert len(content_of(place)) == 1 << 27
    for size in ((1 << 27) + 1, 1 << 40):
        os.truncate(place, size)
        told = rf"model\.json has {size} bytes. Needed: at most 134217728"
        with pytest.raises(ParameterFileError, match=told):
            content_of(place)


def test_a_text_by_hand_may_begin_with_a_mark_and_must_be_text(tmp_path: Path) -> None:
    place = tmp_path / "design.toml"
    place.write_bytes("\ufeffgrün".encode())
    assert text_of(place) == "grün"
    place.write_bytes(b"\xff\xfe")
    with pytest.raises(LabFileError, match="text in UTF-8"):
        text_of(place)


@pytest.mark.parametrize(
    ("name", "verb"),
    [
        ("model.json", "piezoid fit RECORDINGS --out"),
        ("diagnosis.json", "piezoid fit RECORDINGS --out"),
        ("design.json", "piezoid design"),
        ("params.json", "piezoid export"),
        ("verification.json", "piezoid verify"),
    ],
)
def test_what_is_missing_is_named_with_the_verb_that_writes_it(
    tmp_path: Path, name: str, verb: str
) -> None:
    with pytest.raises(ParameterFileError) as found:
        content_of(tmp_path / name)
    assert str(found.value).startswith(f"{tmp_path} contains no {name}. Needed: ")
    assert f"Run `{verb} {tmp_path}` first." in str(found.value)


def test_a_fitted_stage_without_a_design_is_sent_to_design_and_not_to_export(
    tmp_path: Path,
) -> None:
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(ParameterFileError, match=f"Run `piezoid design {tmp_path}`"):
        content_of(tmp_path / "params.json")


def test_a_stage_whose_controllers_failed_is_not_sent_back_to_export(tmp_path: Path) -> None:
    (tmp_path / "refused").mkdir()
    with pytest.raises(ParameterFileError, match="failed its verification") as found:
        content_of(tmp_path / "params.json")
    assert "refused/verification.json" in str(found.value)
    assert "piezoid export" not in str(found.value)


def test_a_folder_that_is_not_there_and_a_file_in_its_place_are_told_apart(tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text("")
    with pytest.raises(ParameterFileError, match="nowhere does not exist"):
        content_of(tmp_path / "nowhere" / "model.json")
    with pytest.raises(ParameterFileError, match=r"page\.html is a file"):
        content_of(tmp_path / "page.html" / "model.json")
    with pytest.raises(ParameterFileError, match=r"limits\.toml does not exist"):
        text_of(tmp_path / "limits.toml")


def test_no_draft_is_written_of_a_recording_that_is_not_there(tmp_path: Path) -> None:
    draft = tmp_path / "lab.toml"
    with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
        init([tmp_path / "nowhere.csv"], draft)
    assert not draft.exists()
