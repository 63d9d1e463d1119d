"""TOML that lies, overflows or never ends is refused with one message."""

from pathlib import Path

import pytest

from piezoid.errors import LabFileError
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import read_lab
from piezoid.verification.criteria import limits_from_toml

ENTRY = '[[recording]]\nfile = "run.csv"\n'


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[acquisition]\ndac_bits = " + "9" * 4000, "very many digits"),
        ("[acquisition]\ndac_bits = " + "9" * 9000, "4300 digits"),
        ("[acquisition]\nsampling_rate_Hz = " + "9" * 4000, "out of range"),
        ("[acquisition]\nsampling_rate_Hz = 1e-320", "is 1e-320"),
        ("[acquisition]\ninput_range_V = [-inf, inf]", "is -inf"),
        ("[actuator]\ngain_m_per_V = nan", "is nan"),
        (f"{ENTRY}start_s = 1e308", "is 1e.308"),
        ('[[recording]]\nfile = "\\u0000"', "zero character"),
        ("a = " + "[" * 100_000, "nested too deep"),
        ("a" + ".a" * 500 + " = 1", "unknown field"),
        ("[verification]\njudged_Hz" + ".a" * 500 + " = 1", "Expected `float`"),
        ("[rig]\na" + ".a" * 100_000 + " = 1", "line 2 contains 100000 dots"),
        ("[" + "x" * 1_000_000 + "]", "unknown field"),
    ],
)
def test_a_lab_file_that_cannot_be_used_is_refused_with_its_place(
    text: str, said: str, tmp_path: Path
) -> None:
    place = tmp_path / "lab.toml"
    place.write_text(text)
    with pytest.raises(LabFileError, match=said) as told:
        read_lab(place)
    assert len(str(told.value)) < 3000


DEEP = "{}" + ".a" * 1000 + " = 1"


@pytest.mark.parametrize("form", [DEEP, "{} = " + "9" * 9000, "{} = '" + "x" * 10**6 + "'"])
def test_limits_of_any_depth_and_length_are_refused(form: str) -> None:
    for name in ("judged_Hz", "unheard_of"):
        with pytest.raises(LabFileError) as told:
            limits_from_toml(form.format(name))
        assert len(str(told.value)) < 3000


@pytest.mark.parametrize("name", ["loop.csv", "x" * 5000])
def test_an_entry_about_a_file_that_cannot_be_is_about_no_file(name: str, tmp_path: Path) -> None:
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    rows = "".join(f"{k / 1000},{k % 7},{k % 5}\n" for k in range(60))
    (tmp_path / "run.csv").write_text("time [s],voltage [V],position [um]\n" + rows)
    (tmp_path / "lab.toml").write_text(f'[[recording]]\nfile = "{name}"\n')
    lab = read_lab(tmp_path / "lab.toml")
    assert lab.entries_of(tmp_path / "run.csv") == ()
    with pytest.raises(LabFileError, match=r"lab.toml: \[\[recording\]\]"):
        inspect_files([tmp_path / "run.csv"], lab)


def test_a_file_in_more_parts_than_anybody_names_is_refused_by_their_number(
    tmp_path: Path,
) -> None:
    (tmp_path / "lab.toml").write_text(ENTRY * 257)
    with pytest.raises(LabFileError, match=r"257 entries are about run.csv.*at most 256 parts"):
        read_lab(tmp_path / "lab.toml").entries_of(tmp_path / "run.csv")
    (tmp_path / "lab.toml").write_text(ENTRY * 256)
    assert len(read_lab(tmp_path / "lab.toml").entries_of(tmp_path / "run.csv")) == 256


def test_a_lab_file_larger_than_anybody_writes_is_refused_unread(tmp_path: Path) -> None:
    place = tmp_path / "lab.toml"
    with place.open("wb") as stream:
        stream.truncate(3 << 30)
    with pytest.raises(LabFileError, match=r"it has 3221225472 bytes\. Needed: at most 4194304"):
        read_lab(place)
