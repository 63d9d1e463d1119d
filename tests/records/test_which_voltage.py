"""One voltage is meant everywhere, and a recording of the other is told with what mends it."""

from pathlib import Path

import pytest

from piezoid.records.checks.command_range import MAY_BE_HIGH_VOLTAGE
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.records.recording import Recording
from tests.laws import triangles, write

GAIN = "[amplifier]\ngain_V_per_V = 15\n"
CONVERTER = "[acquisition]\ninput_range_V = [-10, 10]\n"


def recorded(folder: Path, lab: str, *, most_V: float) -> Recording:
    """Return a recording of triangles from 0 V to ``most_V``, whose entry may end ``lab``."""
    drive_V = 0.5 * most_V * (1.0 + triangles(5, 240, 0.15))
    place = write(folder / "run.csv", drive_V / 5, drive_V)
    (folder / "lab.toml").write_text(lab)
    return collect([place], read_lab(folder / "lab.toml"))[0]


def told(recording: Recording) -> list[str]:
    return [one.text for one in recording.statements if one.quantity == "beyond_the_controller"]


@pytest.mark.parametrize(
    ("lab", "most_V", "is_told"),
    [
        (GAIN + CONVERTER, 9.9, False),
        (GAIN + CONVERTER, 10.1, False),  # a monitor's calibration
        (GAIN + CONVERTER, 120.0, True),
        (CONVERTER, 120.0, True),
        (GAIN, 120.0, False),  # nobody said what the controller gives
        (GAIN + "output_min_V = -30\noutput_max_V = 150\n", 10.0, False),
        (GAIN + "output_min_V = -30\noutput_max_V = 150\n", 150.0, True),
        ("", 120.0, False),
    ],
)
def test_a_drive_that_the_controller_cannot_put_out_is_told(
    tmp_path: Path, lab: str, most_V: float, is_told: bool
) -> None:
    assert bool(told(recorded(tmp_path, lab, most_V=most_V))) is is_told


def test_the_scale_it_names_makes_it_the_controllers_output(tmp_path: Path) -> None:
    lab = GAIN + CONVERTER
    (said,) = told(recorded(tmp_path, lab, most_V=120.0))
    assert "0 V to 120 V" in said.replace("\u202f", " ")
    scale = "scale = { voltage = 0.0666666667 }"
    assert scale in said
    entry = f'[[recording]]\nfile = "run.csv"\n{scale}\n'
    mended = recorded(tmp_path, lab + entry, most_V=120.0)
    assert told(mended) == []
    assert float(mended.channels[0].values.max()) == pytest.approx(8.0, rel=0.1)


@pytest.mark.parametrize(
    ("heading", "lab", "is_asked"),
    [
        ("HV monitor (V)", "", True),
        ("High voltage (V)", GAIN, True),
        ("HV monitor (V)", GAIN + "output_min_V = -30\noutput_max_V = 3000\n", False),
        ("HV monitor (V)", '[[recording]]\nfile = "hv.csv"\nscale = { voltage = 0.1 }\n', False),
        ("drive voltage (V)", "", False),
    ],
)
def test_a_heading_of_high_voltage_asks_which_voltage_it_is(
    tmp_path: Path, heading: str, lab: str, is_asked: bool
) -> None:
    drive_V = 50.0 * (1.0 + triangles(5, 240, 0.15))
    rows = "".join(f"{k / 1e3},{v:.6f},{v / 5:.6f}\n" for k, v in enumerate(drive_V))
    (tmp_path / "hv.csv").write_text(f"time (s),{heading},position (um)\n{rows}")
    (tmp_path / "lab.toml").write_text(lab)
    (recording,) = collect([tmp_path / "hv.csv"], read_lab(tmp_path / "lab.toml"))
    asked = [fact for fact in recording.statements if fact.quantity == MAY_BE_HIGH_VOLTAGE]
    assert bool(asked) is is_asked
