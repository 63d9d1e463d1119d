"""A drive recorded behind the amplifier is reported with the scale that corrects it."""

from pathlib import Path

import pytest

from piezoid.records.checks.command_range import MAY_BE_HIGH_VOLTAGE
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab
from piezoid.records.recording import Recording
from tests.laws import triangles, write
from tests.records.tables import quantities_of, statements_of

GAIN = "[amplifier]\ngain_V_per_V = 15\n"
CONVERTER = "[acquisition]\ninput_range_V = [-10, 10]\n"


def recorded(folder: Path, lab: str, *, max_V: float) -> Recording:
    """Return a recording of triangles from 0 V to ``max_V``, whose entry may end ``lab``."""
    drive_V = 0.5 * max_V * (1.0 + triangles(5, 240, 0.15))
    path = write(folder / "run.csv", drive_V / 5, drive_V)
    (folder / "lab.toml").write_text(lab)
    return collect([path], read_lab(folder / "lab.toml"))[0]


BEYOND = "beyond_the_controller"


@pytest.mark.parametrize(
    ("lab", "max_V", "is_reported"),
    [
        (GAIN + CONVERTER, 9.9, False),
        (GAIN + CONVERTER, 10.1, False),  # calibration of a monitor
        (GAIN + CONVERTER, 120.0, True),
        (CONVERTER, 120.0, True),
        (GAIN, 120.0, False),  # the range of the controller is unknown
        (GAIN + "output_min_V = -30\noutput_max_V = 150\n", 10.0, False),
        (GAIN + "output_min_V = -30\noutput_max_V = 150\n", 150.0, True),
        ("", 120.0, False),
    ],
)
def test_a_drive_beyond_the_range_of_the_controller_is_reported(tmp_path, lab, max_V, is_reported):
    assert (BEYOND in quantities_of(recorded(tmp_path, lab, max_V=max_V))) is is_reported


def test_the_suggested_scale_gives_the_output_of_the_controller(tmp_path):
    lab = GAIN + CONVERTER
    (statement,) = statements_of(recorded(tmp_path, lab, max_V=120.0), BEYOND)
    assert "0 V to 120 V" in statement.text.replace("\u202f", " ")
    scale = "scale = { voltage = 0.0666666667 }"
    assert scale in statement.text
    entry = f'[[recording]]\nfile = "run.csv"\n{scale}\n'
    scaled = recorded(tmp_path, lab + entry, max_V=120.0)
    assert BEYOND not in quantities_of(scaled)
    assert float(scaled.channels[0].values.max()) == pytest.approx(8.0, rel=0.1)


@pytest.mark.parametrize(
    ("heading", "lab", "is_questioned"),
    [
        ("HV monitor (V)", "", True),
        ("High voltage (V)", GAIN, True),
        ("HV monitor (V)", GAIN + "output_min_V = -30\noutput_max_V = 3000\n", False),
        ("HV monitor (V)", '[[recording]]\nfile = "hv.csv"\nscale = { voltage = 0.1 }\n', False),
        ("drive voltage (V)", "", False),
    ],
)
def test_a_heading_of_high_voltage_is_questioned(tmp_path, heading, lab, is_questioned):
    drive_V = 50.0 * (1.0 + triangles(5, 240, 0.15))
    rows = "".join(f"{k / 1e3},{v:.6f},{v / 5:.6f}\n" for k, v in enumerate(drive_V))
    (tmp_path / "hv.csv").write_text(f"time (s),{heading},position (um)\n{rows}")
    (tmp_path / "lab.toml").write_text(lab)
    (recording,) = collect([tmp_path / "hv.csv"], read_lab(tmp_path / "lab.toml"))
    assert (MAY_BE_HIGH_VOLTAGE in quantities_of(recording)) is is_questioned
