"""Draw the figure of docs/measured/accuracy.md from the bundled recordings.

    python benchmarks/first_figure.py docs/images/first_figure.svg

The model is fitted to the recordings of sweep and rates. The figure shows its prediction of the
third recording.
"""

import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np

import piezoid_datasets
from piezoid.identification.fit import rig_of
from piezoid.identification.hysteresis.coordinates import Shape
from piezoid.identification.hysteresis.pieces import pieces_of, scales_of
from piezoid.identification.hysteresis.search import (
    Settings,
    refit_initial_state,
    search,
)
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab


def main() -> None:
    """Write the figure."""
    mpl.use("svg")
    mpl.rcParams.update({"svg.hashsalt": "piezoid", "font.size": 9, "svg.fonttype": "none"})
    from matplotlib import pyplot as plt

    lab = read_lab(piezoid_datasets.LAB)
    recordings = collect(piezoid_datasets.recordings()[:3], lab).recordings
    rig = rig_of(lab, "x")
    scales = scales_of(recordings, "x")
    sweep, check, rates = pieces_of(recordings, "x", scales, rig)
    settings = Settings(
        longest_lag_s=0.02, sensor_pole_Hz=rig.sensor_bandwidth_Hz, follow_zero=False
    )
    errors_nm = []
    for shape in (Shape(plays=0, below=0, above=0), Shape(plays=16, below=6, above=6, bends=6)):
        fit = refit_initial_state(search([sweep, rates], shape, settings), [check])
        error = check.response - fit.simulate(0, check)
        errors_nm.append(1e9 * abs(scales.displacement_m) * error)
    seconds = np.arange(len(check.drive)) / check.sampling_rate_Hz
    figure, (loop_axes, error_axes) = plt.subplots(1, 2, figsize=(9, 3.2), width_ratios=(1, 1.7))
    span_um = 1e6 * abs(scales.displacement_m)
    thin = slice(None, None, 6)
    volts = check.drive * scales.voltage_V + scales.voltage_offset_V
    loop_axes.plot(volts[thin], span_um * check.response[thin], color="#0072b2", lw=0.7)
    loop_axes.set(
        xlabel="drive [V]", ylabel="displacement [um]", title="measured, not used in the fit"
    )
    names = ("straight line", "model")
    for error_nm, colour, name in zip(errors_nm, ("#bbbbbb", "#d55e00"), names, strict=True):
        rms_nm = float(np.sqrt(np.mean(error_nm**2)))
        label = f"{name}: {rms_nm:.0f} nm rms"
        error_axes.plot(seconds[thin], error_nm[thin], color=colour, lw=0.7, label=label)
    error_axes.set(xlabel="time [s]", ylabel="measured - simulated [nm]", title="residual")
    error_axes.set_ylim(-2100, 2500)
    error_axes.legend(frameon=False, loc="upper left", ncols=2)
    for axes in (loop_axes, error_axes):
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout()
    figure.savefig(Path(sys.argv[1]), metadata={"Date": None, "Creator": "piezoid"})


if __name__ == "__main__":
    main()
