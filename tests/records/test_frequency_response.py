"""Frequency responses in every notation are read as the same response, or refused."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from piezoid.errors import LabFileError, RecordingError
from piezoid.records.collection import collect
from piezoid.records.frequency_response import FrequencyResponseRecord, ResponsePath
from piezoid.records.inspection import inspect_files
from piezoid.records.lab import Lab, read_lab
from piezoid.records.lab_draft import draft_lab
from tests.records.responses import (
    FREQUENCY_Hz,
    cells_of,
    matrix,
    response,
    write_cells,
    write_csv,
    write_matlab,
)
from tests.records.tables import refusal_of

G = response()
SIZE_um, ANGLE_deg = np.abs(G) * 1e6, np.degrees(np.angle(G))
DECIBEL = 20.0 * np.log10(SIZE_um)
SORTED = "f [Hz],gain [um/V],phase [deg]"
WRITERS: dict[str, Callable[[Path], Path]] = {
    "decibel and degrees": lambda f: write_csv(
        f / "a.csv",
        "Frequency (Hz),Magnitude (dB re 1 um/V),Phase (deg)",
        *(FREQUENCY_Hz, DECIBEL, ANGLE_deg),
    ),
    "linear and radians": lambda f: write_csv(
        f / "a.csv", "freq_kHz,gain_um_per_V,phase_rad", FREQUENCY_Hz / 1e3, SIZE_um, np.angle(G)
    ),
    "unwrapped radians over rad/s": lambda f: write_csv(
        f / "a.csv",
        "omega [rad/s],|H| mag [nm/mV],theta [rad]",
        *(2.0 * np.pi * FREQUENCY_Hz, SIZE_um, np.unwrap(np.angle(G))),
    ),
    "real and imaginary": lambda f: write_csv(
        f / "a.csv", "f [Hz],Re [um/V],Im [um/V]", FREQUENCY_Hz, G.real * 1e6, G.imag * 1e6
    ),
    "downward": lambda f: write_csv(
        f / "a.csv",
        "f [Hz],Re [um/V],Im [um/V]",
        *(FREQUENCY_Hz[::-1], G.real[::-1] * 1e6, G.imag[::-1] * 1e6),
    ),
    "complex cells of MATLAB": lambda f: write_cells(f / "a.csv", ",", "{re:.9g}{im:+.9g}i"),
    "complex cells of NumPy": lambda f: write_cells(f / "a.txt", " ", "({re:.9e}+{im:.9e}j)"),
    "complex cells, spaced": lambda f: write_cells(
        f / "a.csv", ";", "{re:.9g} {sign} {size:.9g}i"
    ),
    "MATLAB, complex": lambda f: write_matlab(f / "a.mat", f_Hz=FREQUENCY_Hz, H_m_per_V=G),
    "MATLAB, gain and phase": lambda f: write_matlab(
        f / "a.mat", freq_Hz=FREQUENCY_Hz, mag_um_per_V=SIZE_um, phase_deg=ANGLE_deg
    ),
}


def lab_of(folder: Path, entry: str, tables: str = "") -> Lab:
    (folder / "lab.toml").write_text(f"{tables}[[recording]]\n{entry}")
    return read_lab(folder / "lab.toml")


def read_response(path: Path, lab: Lab | None = None) -> FrequencyResponseRecord:
    collection = collect([path], lab)
    assert not collection.recordings
    (record,) = collection.responses
    return record


def assert_true(record: FrequencyResponseRecord, axis: str = "x") -> None:
    path = record.path(axis, axis)
    assert path is not None
    np.testing.assert_allclose(record.frequency_Hz, FREQUENCY_Hz, rtol=1e-8)
    np.testing.assert_allclose(path.response_m_per_V, G, rtol=1e-6)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_every_notation_gives_the_same_response(write, tmp_path):
    assert_true(read_response(write(tmp_path)))


@pytest.mark.parametrize(
    ("heading", "columns", "words", "entry"),
    [
        (
            "Frequency (Hz),Magnitude (dB),Phase (deg)",
            (FREQUENCY_Hz, DECIBEL, ANGLE_deg),
            "is in dB without a reference",
            'units = { magnitude = "dB re 1 um/V" }\n',
        ),
        (
            "f [Hz],gain [V/V],phase [deg]",
            (FREQUENCY_Hz, SIZE_um * 0.2, ANGLE_deg),
            "gain_V_per_m",
            "[sensor]\ngain_V_per_m = 2e5\n",
        ),
        (
            f"{SORTED},coherence",
            (FREQUENCY_Hz, SIZE_um, ANGLE_deg, np.full(len(G), 98.0)),
            "from 0 to 1",
            'units = { coherence = "%" }\n',
        ),
        (
            f"time [s],{SORTED}",
            (np.arange(len(G)) * 0.1, FREQUENCY_Hz, SIZE_um, ANGLE_deg),
            r"in one file\. Needed: one of the two",
            'columns = { frequency = "f [Hz]", magnitude = "gain [um/V]", '
            'phase = "phase [deg]" }\n',
        ),
    ],
    ids=["decibels of nothing", "volts of a sensor", "coherence in percent", "time and frequency"],
)
def test_an_ambiguous_response_needs_an_entry_in_lab_toml(
    heading, columns, words, entry, tmp_path
):
    path = write_csv(tmp_path / "a.csv", heading, *columns)
    with pytest.raises(RecordingError, match=words):
        collect([path])
    is_rig = entry.startswith("[sensor]")
    lab = lab_of(tmp_path, 'file = "a.csv"\n' + entry * (not is_rig), entry * is_rig)
    record = read_response(path, lab)
    assert_true(record)
    coherence = record.paths[0].coherence
    assert (coherence is not None) == ("coherence" in heading)
    if coherence is not None:
        np.testing.assert_allclose(coherence, 0.98)


def test_an_amplitude_of_a_lock_in_is_divided_by_its_excitation(tmp_path):
    excitation_V = np.linspace(0.5, 0.6, len(G))
    rows = np.column_stack([FREQUENCY_Hz, np.abs(G) * excitation_V, ANGLE_deg, excitation_V])
    lines = ["\t".join(f"{x:.10e}" for x in row) for row in rows]
    names = "Frequency (Hz)\tAmplitude (m)\tPhase (deg)\tExcitation (V)"
    path = tmp_path / "a.dat"
    path.write_text("\n".join(["Experiment\tFrequency Sweep\n", "[DATA]", names, *lines, ""]))
    with pytest.raises(RecordingError, match="an amplitude and not a response"):
        collect([path])
    columns = (
        'columns = { frequency = "Frequency (Hz)", magnitude = "Amplitude (m)", '
        'phase = "Phase (deg)", excitation = "Excitation (V)" }\n'
    )
    assert_true(read_response(path, lab_of(tmp_path, f'file = "a.dat"\n{columns}')))


PAIRS = [(i, j) for i in range(3) for j in range(3)]


def write_matrix(folder: Path) -> Path:
    return write_matlab(folder / "a.mat", f_Hz=FREQUENCY_Hz, H_m_per_V=matrix())


def write_nine_complex_columns(folder: Path) -> Path:
    names = ["f [Hz]", *(f"H{'xyz'[i]}{'xyz'[j]} [um/V]" for i, j in PAIRS)]
    cells = [cells_of(matrix()[i, j] * 1e6, "{re:.9g}{im:+.9g}i") for i, j in PAIRS]
    rows = zip(map("{:.9g}".format, FREQUENCY_Hz), *cells, strict=True)
    (folder / "a.csv").write_text("\n".join(map(",".join, [names, *rows])))
    return folder / "a.csv"


def write_nine_groups(folder: Path) -> Path:
    heading, columns = ["f [Hz]"], [FREQUENCY_Hz]
    for i, j in PAIRS:
        pair = f"{'xyz'[i]}{'xyz'[j]}"
        heading += [f"mag_{pair} (um/V)", f"phase_{pair} (deg)"]
        columns += [np.abs(matrix()[i, j]) * 1e6, np.degrees(np.angle(matrix()[i, j]))]
    return write_csv(folder / "a.csv", ",".join(heading), *columns)


@pytest.mark.parametrize("write", [write_matrix, write_nine_complex_columns, write_nine_groups])
def test_a_response_of_three_axes_has_every_path(write, tmp_path):
    record = read_response(write(tmp_path))
    assert record.axes == ("x", "y", "z")
    for i, j in PAIRS:
        path = record.path("xyz"[i], "xyz"[j])
        assert path is not None
        np.testing.assert_allclose(path.response_m_per_V, matrix()[i, j], rtol=1e-6)


def test_an_inspection_states_band_peaks_and_coupling(tmp_path):
    (inspection,) = inspect_files([write_matrix(tmp_path)])
    assert inspection.refusal is None
    summary = inspection.response
    assert summary is not None
    assert (summary.lowest_Hz, summary.lines) == (pytest.approx(1.0), 300)
    paths = {p.output: p for p in summary.paths if p.output == p.drive}
    for axis, mode_Hz in zip("xyz", (812.0, 640.0, 1310.0), strict=True):
        (peak,) = paths[axis].peaks
        assert peak.frequency_Hz == pytest.approx(mode_Hz, rel=0.02)
        assert peak.quality == pytest.approx(30.0, rel=0.3)
    assert all(c.low == pytest.approx(0.02, rel=0.05) for c in summary.couplings)


BAD_ROW = 40


def columns_with(column: int, value: float) -> list[np.ndarray]:  # type: ignore[type-arg]
    columns = [FREQUENCY_Hz.copy(), SIZE_um.copy(), ANGLE_deg.copy()]
    columns[column][BAD_ROW] = value
    return columns


RADIANS = SORTED.replace("deg", "rad")
FAULTS = {
    "repeated": (
        SORTED,
        columns_with(0, FREQUENCY_Hz[BAD_ROW - 1]),
        "repeats .* frequencies do not rise",
    ),
    "unsorted": (SORTED, columns_with(0, 2.0), "2 Hz at line 42 follows"),
    "negative": (
        SORTED,
        columns_with(0, -5.0),
        "1 frequencies are negative, the first is -5 Hz at line 42",
    ),
    "empty": (SORTED, columns_with(1, np.nan), "hold no number, the first is line 42"),
    "zero": (SORTED, columns_with(1, 0.0), "is zero in 1 rows, the first is line 42"),
    "below zero": (
        SORTED,
        columns_with(1, -3.0),
        "is -3 at line 42. Needed: a magnitude above zero",
    ),
    "radians called degrees": (
        SORTED,
        [FREQUENCY_Hz, SIZE_um, np.angle(G)],
        r"the unit is wrong\. .*rad is plausible",
    ),
    "degrees called radians": (RADIANS, [FREQUENCY_Hz, SIZE_um, ANGLE_deg], "deg is plausible"),
    "two gains": (
        "f [Hz],gain [um/V],gain [nm/V],phase [deg]",
        [FREQUENCY_Hz, SIZE_um, SIZE_um, ANGLE_deg],
        "both claim to be the magnitude",
    ),
    "a lone gain": (
        "Frequency [Hz],gain [um/V]",
        [FREQUENCY_Hz, SIZE_um],
        "magnitude alone is no response",
    ),
}


@pytest.mark.parametrize(("heading", "columns", "words"), FAULTS.values(), ids=FAULTS)
def test_an_invalid_response_is_refused_with_its_line(
    heading,
    columns,  # type: ignore[type-arg]
    words,
    tmp_path,
):
    path = write_csv(tmp_path / "a.csv", heading, *columns)
    with pytest.raises(RecordingError, match=words):
        collect([path])
    assert re.search(words, refusal_of(path))


def test_a_long_delay_in_radians_is_accepted(tmp_path):
    angle = np.unwrap(np.angle(response(delay_s=0.0))) - 2.0 * np.pi * 0.02 * FREQUENCY_Hz
    record = read_response(write_csv(tmp_path / "a.csv", RADIANS, FREQUENCY_Hz, SIZE_um, angle))
    assert len(record.frequency_Hz) == 300


def test_a_recording_with_a_frequency_shift_stays_a_recording(tmp_path):
    time_s = np.arange(400) / 1000
    drive = np.sin(2 * np.pi * 5 * time_s)
    path = write_csv(
        tmp_path / "a.csv",
        "time [s],voltage [V],position [um],Frequency Shift (Hz),Amplitude (m),Phase (deg)",
        *(time_s, drive, 2 * drive, drive, drive, drive),
    )
    assert len(collect([path]).recordings) == 1


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("columns = { frequency = 1, gain = 2 }", "a frequency response, names 'gain'"),
        ("columns = { frequency = 1, magnitude = 9, phase = 3 }", "no column 9"),
        ('includes = ["stage"]', "includes"),
        ("sampling_rate_Hz = 100.0", "no time and no offset"),
    ],
)
def test_an_invalid_entry_is_refused(entry, words, tmp_path):
    path = write_csv(tmp_path / "a.csv", SORTED, FREQUENCY_Hz, SIZE_um, ANGLE_deg)
    with pytest.raises(LabFileError, match=words):
        collect([path], lab_of(tmp_path, f'file = "a.csv"\n{entry}\n'))


def test_a_drafted_lab_toml_reads_the_same_response(tmp_path):
    path = WRITERS["decibel and degrees"](tmp_path)
    draft = draft_lab([path], tmp_path)
    assert not draft.incomplete
    (tmp_path / "lab.toml").write_text(draft.text)
    assert_true(read_response(path, read_lab(tmp_path / "lab.toml")))


def test_an_invalid_record_is_refused():
    path = ResponsePath(output="x", drive="x", response_m_per_V=G)
    fields = {"name": "a", "digest": "0", "frequency_Hz": FREQUENCY_Hz, "paths": (path,)}
    for invalid in (
        {"frequency_Hz": FREQUENCY_Hz[::-1]},
        {"frequency_Hz": FREQUENCY_Hz - 1.0},
        {"paths": ()},
        {"paths": (path, path)},
        {"includes": ("stage",)},
    ):
        with pytest.raises(ValueError, match=r"expected|does not increase"):
            FrequencyResponseRecord(**{**fields, **invalid})  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="zero"):
        ResponsePath(output="x", drive="x", response_m_per_V=0.0 * G)
