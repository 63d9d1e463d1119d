"""lab.toml is read as documented; invalid and hostile files are refused."""

from pathlib import Path

import pytest

from piezoid.errors import LabFileError
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, read_lab
from piezoid.verification.criteria import limits_from_toml
from tests.records.tables import HEADINGS, ROWS

EVERYTHING = """
[rig]
name = "stage 42"
[amplifier]
gain_V_per_V = 15
bandwidth_Hz = 4000
output_min_V = -20
output_max_V = 150
slew_V_per_s = 3e5
[actuator]
gain_m_per_V = 235e-9
[sensor]
bandwidth_Hz = 8500
gain_V_per_m = 2e5
[acquisition]
sampling_rate_Hz = 20000
dac_bits = 16
adc_bits = 16
input_range_V = [-10, 10]
[axis.z.sensor]
gain_V_per_m = 4e5
[[recording]]
file = "sweep.csv"
axis = "x"
columns = { time = "time [s]", voltage = "U", displacement = 3 }
units = { displacement = "um" }
start_s = 1
stop_s = 2.5
"""


ENTRY = '[[recording]]\nfile = "run.csv"\n'


def lab_of(text: str, folder: Path) -> Lab:
    path = folder / "lab.toml"
    path.write_text(text)
    return read_lab(path)


def test_every_documented_key_is_read(tmp_path):
    lab = lab_of(EVERYTHING, tmp_path)
    assert lab.name == "stage 42"
    assert lab.amplifier.slew_V_per_s == 3e5
    assert lab.acquisition.input_range_V == (-10, 10)
    assert lab.recordings[0].columns == {"time": "time [s]", "voltage": "U", "displacement": 3}
    assert lab.digest.startswith("sha256:")
    assert lab.sensor_of("x").gain_V_per_m == 2e5
    assert lab.sensor_of("z").gain_V_per_m == 4e5
    assert lab.sensor_of("z").bandwidth_Hz is None
    assert lab.amplifier_of("z") is lab.amplifier


def test_an_empty_file_has_defaults_and_entries_match_by_path_then_by_name(tmp_path):
    lab = lab_of("", tmp_path)
    assert lab.amplifier.bandwidth_Hz is None
    assert lab.entries_of(tmp_path / "sweep.csv") == ()
    text = '[[recording]]\nfile = "a/run.csv"\n[[recording]]\nfile = "b/run.csv"\n'
    lab = lab_of(text, tmp_path)
    assert [e.file for e in lab.entries_of(tmp_path / "b" / "run.csv")] == ["b/run.csv"]
    assert len(lab.entries_of(Path("/elsewhere/run.csv"))) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[amplifier]\ngain = 15\n", "amplifier"),
        ('[amplifier]\nbandwidth_Hz = "4 kHz"\n', "amplifier.bandwidth_Hz"),
        ("[amplifier]\nbandwidth_Hz = -1\n", r"\[amplifier\] bandwidth_Hz is -1"),
        ("[amplifier]\noutput_min_V = 5\noutput_max_V = -5\n", "from 5.0 to -5.0"),
        ("[sensor]\ngain_V_per_m = 0\n", "gain_V_per_m is zero"),
        ("[sensor]\ngain_V_per_m = nan\n", "nan"),
        ("[axis.z.sensor]\ngain_V_per_m = inf\n", r"\[axis.z.sensor\]"),
        ("[acquisition]\ninput_range_V = [1]\n", "input_range_V"),
        ("[acquisition]\nadc_bits = 0\n", "adc_bits is 0"),
        ('[[recording]]\naxis = "x"\n', "file"),
        ("[[recording]]\nfile = 3\n", "recording"),
        ("[rig\n", "line 1"),
        ("a = 1\na = 2\n", "line 2"),
        ("[amplifier]\nbandwidth_Hz = 1e-20\n", "bandwidth_Hz is 1e-20"),
        # keys without effect because another key is missing
        ("[acquisition]\ndac_bits = 16\n", "input_range_V"),
        ("[acquisition]\nadc_bits = 16\n", "input_range_V"),
        ("[coupled]\nsettling_periods = 2\n", "axes"),
        *(
            (f"[amplifier]\n{key} = 5\n[axis.x.amplifier]\ngain_V_per_V = 2\n", key)
            for key in ("output_min_V", "output_max_V", "slew_V_per_s")
        ),
        # impossible text tables
        (f'{ENTRY}separator = "ab"\n', "separator is 'ab'"),
        (f'{ENTRY}decimal = ";"\n', "decimal"),
        (f"{ENTRY}heading_row = 0\n", "heading_row is 0"),
        (f"{ENTRY}scale = {{ voltage = 0 }}\n", "scale is zero"),
        # numbers that overflow, and endless texts
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
        # misspelt names
        (
            "[acquisition]\nsampling_rate_hz = 1000\n",
            r"did you mean sampling_rate_Hz\?",
        ),
        ("[amplifer]\ngain_V_per_V = 15\n", r"did you mean amplifier\?"),
        ('[[recording]]\nfile = "a.csv"\ncolumn = {}\n', r"did you mean columns\?"),
    ],
)
def test_an_invalid_entry_is_refused_with_its_key(text, message, tmp_path):
    with pytest.raises(LabFileError, match=message) as refusal:
        lab_of(text, tmp_path)
    assert len(str(refusal.value)) < 3000


def test_a_missing_file_and_other_encodings_are_refused(tmp_path):
    with pytest.raises(LabFileError):
        read_lab(tmp_path / "nothing.toml")
    (tmp_path / "lab.toml").write_bytes(b"\xff\x00\xfe")
    with pytest.raises(LabFileError):
        read_lab(tmp_path / "lab.toml")


DEEP = "{}" + ".a" * 1000 + " = 1"


@pytest.mark.parametrize("form", [DEEP, "{} = " + "9" * 9000, "{} = '" + "x" * 10**6 + "'"])
def test_hostile_limits_are_refused_with_a_short_message(form):
    for name in ("judged_Hz", "unheard_of"):
        with pytest.raises(LabFileError) as refusal:
            limits_from_toml(form.format(name))
        assert len(str(refusal.value)) < 3000


@pytest.mark.parametrize("name", ["loop.csv", "x" * 5000])
def test_an_entry_about_an_impossible_file_matches_none(name, tmp_path):
    (tmp_path / "loop.csv").symlink_to(tmp_path / "loop.csv")
    (tmp_path / "run.csv").write_text(f"{HEADINGS}\n{ROWS}")
    (tmp_path / "lab.toml").write_text(f'[[recording]]\nfile = "{name}"\n')
    lab = read_lab(tmp_path / "lab.toml")
    assert lab.entries_of(tmp_path / "run.csv") == ()
    with pytest.raises(LabFileError, match=r"lab.toml: \[\[recording\]\]"):
        inspect_files([tmp_path / "run.csv"], lab)


def test_too_many_entries_about_a_file_are_refused(tmp_path):
    (tmp_path / "lab.toml").write_text(ENTRY * 257)
    with pytest.raises(LabFileError, match=r"257 entries are about run.csv.*at most 256 parts"):
        read_lab(tmp_path / "lab.toml").entries_of(tmp_path / "run.csv")
    (tmp_path / "lab.toml").write_text(ENTRY * 256)
    assert len(read_lab(tmp_path / "lab.toml").entries_of(tmp_path / "run.csv")) == 256


def test_a_huge_lab_file_is_refused_unread(tmp_path):
    path = tmp_path / "lab.toml"
    with path.open("wb") as stream:
        stream.truncate(3 << 30)
    with pytest.raises(LabFileError, match=r"it has 3221225472 bytes\. Needed: at most 4194304"):
        read_lab(path)
