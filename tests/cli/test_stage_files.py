"""Files of a stage: types, sizes, and messages about missing files."""

import os

import pytest

from piezoid.errors import LabFileError, ParameterFileError
from piezoid_cli.init import init
from piezoid_cli.stage_files import content_of, text_of


def test_a_pipe_or_device_instead_of_a_sealed_file_is_refused(tmp_path):
    os.mkfifo(tmp_path / "model.json")
    (tmp_path / "params.json").symlink_to("/dev/zero")
    for name in ("model.json", "params.json"):
        with pytest.raises(OSError, match="a pipe or a device"):
            content_of(tmp_path / name)


def test_a_file_above_the_size_limit_is_refused(tmp_path):
    """The files are sparse and need no disk space."""
    path = tmp_path / "model.json"
    path.write_bytes(b"x" * 100)
    assert content_of(path) == b"x" * 100
    os.truncate(path, 1 << 27)
    assert len(content_of(path)) == 1 << 27
    for size in ((1 << 27) + 1, 1 << 40):
        os.truncate(path, size)
        message = rf"model\.json has {size} bytes. Needed: at most 134217728"
        with pytest.raises(ParameterFileError, match=message):
            content_of(path)


def test_a_text_may_begin_with_a_byte_order_mark_and_must_be_utf_8(tmp_path):
    path = tmp_path / "design.toml"
    path.write_bytes("\ufeffgrün".encode())
    assert text_of(path) == "grün"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(LabFileError, match="text in UTF-8"):
        text_of(path)


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
def test_a_missing_file_is_named_with_the_verb_that_writes_it(tmp_path, name, verb):
    with pytest.raises(ParameterFileError) as refusal:
        content_of(tmp_path / name)
    assert str(refusal.value).startswith(f"{tmp_path} contains no {name}. Needed: ")
    assert f"Run `{verb} {tmp_path}` first." in str(refusal.value)


@pytest.mark.parametrize("name", ["design.json", "params.json"])
def test_a_fit_without_controllers_has_neither_design_nor_parameters(tmp_path, name):
    (tmp_path / "model.json").touch()
    with pytest.raises(ParameterFileError, match=r"designed none.*which states what is missing"):
        content_of(tmp_path / name)


def test_missing_parameters_are_explained_by_the_other_files_of_the_stage(tmp_path):
    (tmp_path / "model.json").write_text("{}")
    with pytest.raises(ParameterFileError, match=f"Run `piezoid design {tmp_path}`"):
        content_of(tmp_path / "params.json")
    (tmp_path / "refused").mkdir()
    with pytest.raises(ParameterFileError, match="failed its verification") as refusal:
        content_of(tmp_path / "params.json")
    assert "refused/verification.json" in str(refusal.value)
    assert "piezoid export" not in str(refusal.value)


def test_a_missing_folder_and_a_file_in_its_place_have_different_messages(tmp_path):
    (tmp_path / "page.html").write_text("")
    with pytest.raises(ParameterFileError, match="nowhere does not exist"):
        content_of(tmp_path / "nowhere" / "model.json")
    with pytest.raises(ParameterFileError, match=r"page\.html is a file"):
        content_of(tmp_path / "page.html" / "model.json")
    with pytest.raises(ParameterFileError, match=r"limits\.toml does not exist"):
        text_of(tmp_path / "limits.toml")


def test_no_draft_is_written_for_a_missing_recording(tmp_path):
    draft = tmp_path / "lab.toml"
    with pytest.raises(FileNotFoundError, match=r"nowhere\.csv"):
        init([tmp_path / "nowhere.csv"], draft)
    assert not draft.exists()
