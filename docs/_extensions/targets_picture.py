"""The picture of the page about targets: two units in FMPy.

A stage is fitted to one bundled recording and exported when the documentation is built; the loop
is that of a master that knows nothing of piezoid.
"""

import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

import fmpy
import made_pages
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from sphinx.application import Sphinx

from piezoid.export.parameter_file import from_json
from piezoid.numerics.arrays import Array

ROOT = Path(__file__).resolve().parents[2]
BLUE, ORANGE = "#0072b2", "#d55e00"
FREQUENCY_Hz, TURNS, HALF_m = 50.0, 4, 5e-6


def _write(app: Sphinx) -> None:
    with tempfile.TemporaryDirectory() as made:
        stage = Path(made) / "stage"
        recording, lab = (str(ROOT / "datasets" / name) for name in ("x_sweep.csv", "lab.toml"))
        _piezoid("fit", recording, "--lab", lab, "--out", str(stage))
        _piezoid("export", str(stage), "--target", "fmu")
        made_pages.write(app, "targets", {"targets.svg": _picture(stage)})


def _piezoid(*words: str) -> None:
    command = [str(Path(sys.executable).parent / "piezoid"), *words, "--quiet"]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)


def _picture(stage: Path) -> bytes:
    figure = Figure(figsize=(5.0, 3.0), layout="constrained")
    axes = figure.subplots()
    for order, colour in (("controller, then plant", BLUE), ("both at once", ORANGE)):
        time_s, error_m = _looped(stage, order == "both at once")
        axes.plot(1e3 * time_s, 1e9 * error_m, color=colour, lw=0.9, label=order)
    axes.set(xlabel="time [ms]", ylabel="error [nm]", title="two units in FMPy, sine of 50 Hz")
    axes.set_ylim(-60.0, 60.0)  # the first milliseconds, from rest to full speed, leave the page
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize="small")
    with tempfile.TemporaryFile() as file, mpl.rc_context({"svg.hashsalt": "piezoid"}):
        figure.savefig(file, format="svg", metadata={"Date": None, "Creator": "piezoid"})
        file.seek(0)
        return file.read()


def _looped(stage: Path, at_once: bool) -> tuple[Array, Array]:
    """Return time and error of a loop of both units."""
    with tempfile.TemporaryDirectory() as made:
        controller, references = _unit(stage, "x_controller", Path(made))
        plant, plants = _unit(stage, "x_plant", Path(made))
        begin_V = plant.getReal([plants["voltage_V"]])[0]
        controller.setReal([references["start_voltage_V"]], [begin_V])
        for unit in (controller, plant):
            unit.setupExperiment(startTime=0.0)
            unit.enterInitializationMode()
            unit.exitInitializationMode()
        period_s = float(
            fmpy.read_model_description(
                str(stage / "fmu" / "x_plant_fmi2.fmu")
            ).defaultExperiment.stepSize
        )
        samples = round(TURNS / FREQUENCY_Hz / period_s)
        time_s = period_s * np.arange(samples)
        file = from_json((stage / "params.json").read_bytes(), "params.json")
        ahead_s = period_s * float(file.axis("x").values["preview_samples"])
        middle_m = plant.getReal([plants["position_m"]])[0]
        wanted_m, given_m = (
            middle_m + HALF_m * np.sin(2.0 * np.pi * FREQUENCY_Hz * (time_s + early_s))
            for early_s in (0.0, ahead_s)
        )
        error_m = np.empty(samples)
        for k, now_s in enumerate(time_s):
            measured_m, position_m = plant.getReal([plants["measured_m"], plants["position_m"]])
            error_m[k] = wanted_m[k] - position_m
            inputs = [references["reference_m"], references["measured_m"]]
            controller.setReal(inputs, [given_m[k], measured_m])
            if at_once:  # the plant knows the last period's output
                plant.doStep(now_s, period_s)
            controller.doStep(now_s, period_s)
            voltage_V = controller.getReal([references["voltage_V"]])
            plant.setReal([plants["voltage_V"]], voltage_V)
            if not at_once:
                plant.doStep(now_s, period_s)
        for unit in (controller, plant):
            unit.terminate()
            unit.freeInstance()
        return time_s, error_m


def _unit(stage: Path, name: str, folder: Path) -> tuple[fmpy.fmi2.FMU2Slave, Mapping[str, int]]:
    place = str(stage / "fmu" / f"{name}_fmi2.fmu")
    described = fmpy.read_model_description(place)
    slave = fmpy.instantiate_fmu(
        fmpy.extract(place, str(folder / name)), described, fmi_type="CoSimulation"
    )
    return slave, {one.name: one.valueReference for one in described.modelVariables}


def setup(app: Sphinx) -> dict[str, bool]:
    """Draw the picture before any page is read."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
