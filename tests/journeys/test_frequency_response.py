"""A slow sweep and a measured frequency response give a fast and stable control loop."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from piezoid import fit, read, report
from piezoid.design.lateral_task import lateral_task
from piezoid.errors import ExcitationError, PiezoidError
from piezoid.export.parameter_file import from_json
from piezoid.identification.store import read_model, write_model
from piezoid.numerics.arrays import Array
from piezoid.operators.linear import cascade, first_order, resonance, sample
from piezoid.operators.play import play_columns
from piezoid.runtime.controller import Controller
from tests.journeys.command import piezoid, run
from tests.plays_alone import (
    design_briefly,
    fit_few_rows,
    fit_one_order,
    fit_plays_alone,
)
from tests.records.responses import matrix, noisy, response, write_csv, write_matlab

pytestmark = pytest.mark.slow

RATE_Hz = 20_000.0
MODE_Hz, QUALITY, AMPLIFIER_Hz, SENSOR_Hz = 640.0, 25.0, 4000.0, 8500.0
THRESHOLDS_V = np.array([3.0, 8.0, 18.0, 30.0])
WEIGHTS = np.array([0.07, 0.07, 0.06, 0.04])
GAIN_m_per_V = 2.4e-7
LAB = f"""[amplifier]
bandwidth_Hz = {AMPLIFIER_Hz}
[sensor]
bandwidth_Hz = {SENSOR_Hz}
[acquisition]
sampling_rate_Hz = {RATE_Hz}
"""
HEADING = "Frequency (Hz),Magnitude (dB re 1 um/V),Phase (deg),Coherence"


def play_displacement_m(drive_V: Array) -> Array:
    """Return the displacement of a sum of plays with a reversible fraction of 0.76."""
    plays, _ = play_columns(drive_V, THRESHOLDS_V, np.zeros(len(THRESHOLDS_V)))
    return np.asarray(GAIN_m_per_V * (0.76 * drive_V + plays @ WEIGHTS))


def write_sweep(path: Path, rng: np.random.Generator) -> None:
    time_s = np.arange(4500) / 250.0
    size = np.interp(time_s, [0.0, 6.0, 12.0, 18.0], [1.0, 1.0, 0.6, 0.3])
    drive_V = 50.0 - 45.0 * size * np.cos(2.0 * np.pi * (0.3 + 0.04 * time_s) * time_s)
    reading_m = play_displacement_m(drive_V) + 2e-9 * rng.standard_normal(len(drive_V))
    write_csv(path, "time [s],voltage [V],position [um]", time_s, drive_V, reading_m * 1e6)


def write_response(path: Path, rng: np.random.Generator) -> None:
    f = np.geomspace(0.5, 5000.0, 400)
    exact = response(f, ((MODE_Hz, QUALITY, 1.0),), gain_m_per_V=0.76 * GAIN_m_per_V, delay_s=5e-5)
    exact /= (1.0 + 1j * f / AMPLIFIER_Hz) * (1.0 + 1j * f / SENSOR_Hz)
    values, coherence = noisy(rng, exact, 0.003), np.full(len(f), 0.9995)
    is_incoherent = (f > 90.0) & (f < 120.0)
    values[is_incoherent] *= 1.0 + rng.standard_normal(is_incoherent.sum())
    coherence[is_incoherent] = 0.3
    decibel, degrees = 20.0 * np.log10(np.abs(values) * 1e6), np.degrees(np.angle(values))
    write_csv(path, HEADING, f, decibel, degrees, coherence)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path, rng = tmp_path_factory.mktemp("stage"), np.random.default_rng(12)
    write_sweep(path / "sweep.csv", rng)
    write_response(path / "response.csv", rng)
    (path / "lab.toml").write_text(LAB)
    return path


@pytest.fixture(scope="module")
def fitted(folder: Path) -> None:
    """Fit, diagnose and design in the folder, with plays alone."""
    files = (folder / "sweep.csv", folder / "response.csv")
    with pytest.MonkeyPatch.context() as patch:
        fit_plays_alone(patch)
        fit_one_order(patch)
        fit_few_rows(patch)
        design_briefly(patch)
        words = ("fit", *files, "--lab", folder / "lab.toml", "--out", folder / "stage")
        status, output = run(*words, "--processes", "1")  # the patches hold in this process
    assert status == 0, output


@pytest.mark.usefixtures("fitted")
def test_model_and_diagnosis_contain_the_mode_of_the_response(folder):
    axis = read_model((folder / "stage" / "model.json").read_bytes())["x"]
    low_Hz, high_Hz = axis.dynamics.mode_frequency_interval_Hz()[0]
    assert low_Hz - 0.5 < MODE_Hz < high_Hz + 0.5
    assert axis.response.used <= 400 - 10
    missing = json.loads((folder / "stage" / "diagnosis.json").read_text())["not_detected"]
    (reason,) = [absent["reason"] for absent in missing if absent["effect"] == "resonance"]
    stated_Hz = re.search(r"response.csv shows it at (\S+) Hz", reason)
    assert float(stated_Hz[1]) == pytest.approx(MODE_Hz, rel=2e-3)


@pytest.mark.usefixtures("fitted")
def test_the_report_plots_the_response_and_is_reproducible(folder):
    page = (folder / "stage" / "report.html").read_text()
    assert "gain as measured, response.csv" in page
    assert "not fitted" in page
    files = (folder / name for name in ("stage", "sweep.csv", "response.csv"))
    status, output = run("report", *files)
    assert status == 0, output
    assert (folder / "stage" / "report.html").read_text() == page


@pytest.mark.usefixtures("fitted", "plays_alone", "one_order", "few_rows")
def test_a_notebook_uses_the_response_like_the_command_line(folder):
    lab = folder / "lab.toml"
    recordings = read(folder / "sweep.csv", folder / "response.csv", lab=lab)
    model = fit(recordings, lab=lab)
    (notebook_axis,), (command_axis,) = (
        json.loads(content)["axes"].values()
        for content in (write_model(model), (folder / "stage" / "model.json").read_bytes())
    )
    for entry in ("dynamics", "response"):  # the command line also diagnoses the hysteresis
        assert notebook_axis[entry] == command_axis[entry]
    assert "gain as measured, response.csv" in report(model, recordings, lab=lab)


@pytest.mark.usefixtures("fitted", "plays_alone", "one_order", "few_rows")
def test_the_designed_loop_is_fast_and_stable_on_the_simulated_stage(folder):
    lab = folder / "lab.toml"
    sweep_model = fit(read(folder / "sweep.csv", lab=lab), lab=lab)
    sweep_task = lateral_task(sweep_model["x"], RATE_Hz)
    response_loop = json.loads((folder / "stage" / "design.json").read_text())["axes"][0]["loops"][
        0
    ]
    assert response_loop["bandwidth_Hz"] > 5.0 * sweep_task.specification.bandwidth_Hz
    shipped = from_json((folder / "stage" / "params.json").read_bytes(), "params.json").axes[0]
    low_m, high_m = (float(shipped.values[f"reference_{end}_m"]) for end in ("minimum", "maximum"))
    middle_m, reach_m = 0.5 * (low_m + high_m), 0.3 * (high_m - low_m)
    time_s = np.arange(6000) / RATE_Hz
    reference_m = middle_m + reach_m * np.sin(2.0 * np.pi * 10.0 * time_s) * np.minimum(
        time_s / 0.1, 1.0
    )
    reading_m = closed_loop_m(shipped.values, reference_m)
    error_m = reading_m[-2000:] - reference_m[-2000:]
    assert float(np.sqrt(np.mean(error_m**2))) < 0.03 * reach_m


def closed_loop_m(values: dict, reference_m: Array) -> Array:
    """Run the shipped controller on the stage: plays, mode, poles, a delay of one sample."""
    poles = (first_order(AMPLIFIER_Hz), first_order(SENSOR_Hz))
    plant = sample(cascade(resonance(MODE_Hz, 0.5 / QUALITY), *poles), RATE_Hz)
    rest_V = 50.0
    play = np.zeros(len(THRESHOLDS_V))
    play = np.maximum(rest_V - THRESHOLDS_V, np.minimum(rest_V + THRESHOLDS_V, play))
    rest_m = GAIN_m_per_V * (0.76 * rest_V + float(play @ WEIGHTS))
    controller = Controller(values)
    controller.start(rest_V, rest_m)
    state = np.zeros(len(plant.A))
    voltage_V, reading_m, readings_m = rest_V, rest_m, np.empty(len(reference_m))
    for k, reference in enumerate(reference_m.tolist()):
        play = np.maximum(voltage_V - THRESHOLDS_V, np.minimum(voltage_V + THRESHOLDS_V, play))
        force_m = GAIN_m_per_V * (0.76 * voltage_V + float(play @ WEIGHTS)) - rest_m
        state = plant.A @ state + plant.B[:, 0] * force_m
        reading_m = rest_m + float(plant.C[0] @ state)
        readings_m[k] = reading_m
        voltage_V = controller.step(reference, reading_m)
    return readings_m


def test_fit_refuses_a_response_alone_and_inspect_describes_it(folder):
    response, lab = folder / "response.csv", folder / "lab.toml"
    result = piezoid("fit", response, "--lab", lab, "--out", folder / "no")
    assert isinstance(result.exception, ExcitationError)
    assert "no recording over time shows its hysteresis" in str(result.exception)
    status, output = run("inspect", response)
    assert status == 0
    assert "a frequency response, 500 mHz to 5.00 kHz, 400 lines" in output
    assert "possible resonances at 6" in output


def test_inspect_states_the_coupling_of_a_matrix(tmp_path):
    f = np.geomspace(1.0, 3000.0, 300)
    write_matlab(tmp_path / "stage.mat", f_Hz=f, H_m_per_V=matrix())
    status, output = run("inspect", tmp_path / "stage.mat")
    assert status == 0, output
    assert "x moves by 2.0 % of y when y is driven" in output
    assert "coupling is reported, not controlled" in output


def test_a_response_of_an_axis_without_recording_or_name_is_refused(folder):
    text = LAB + '[[recording]]\nfile = "response.csv"\naxis = "y"\n'
    (folder / "y.toml").write_text(text)
    files = (folder / "sweep.csv", folder / "response.csv")
    result = piezoid("fit", *files, "--lab", folder / "y.toml", "--out", folder / "no")
    assert isinstance(result.exception, PiezoidError)
    assert "a frequency response of axis y, and no recording of axis y" in str(result.exception)
