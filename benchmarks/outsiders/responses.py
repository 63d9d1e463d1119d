"""Stages whose recordings show no mode: the loop with and without a measured response.

    python -m benchmarks.outsiders.responses [--only alder] [--stages 201-206]

Recordings that excite dynamics are removed. The frequency response is measured on the plant of the
simulator, as a lock-in amplifier does, with small sines about the rest position through the
converters of the controller. The fit receives it as a CSV file.
"""

import argparse
import ctypes
from pathlib import Path

import numpy as np

from benchmarks.outsiders.lateral import StageResult, evaluate_stage
from benchmarks.outsiders.simulators import NAMES, RATE_Hz, Simulator, seed_range
from piezoid.identification.dynamics.behind_hysteresis import excites_dynamics
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab

AMPLITUDE = 0.01  # of the range of the recorded drives
LINES = 160
LOWEST_Hz, HIGHEST_Hz = 4.0, 6000.0
SETTLING_s = 0.06  # of a mode of 300 Hz and quality 60, to 1/e
PERIODS = 8


def remove_dynamic_recordings(_: Simulator, __: int, recordings: Path) -> None:
    """Remove recordings that excite dynamics, and their entries in lab.toml."""
    lab = recordings / "lab.toml"
    text = lab.read_text()
    for path in sorted(recordings.glob("*.csv")):
        recording = collect([path]).recordings[0]
        if excites_dynamics([recording], recording.axis):
            path.unlink()
            head, entry, tail = text.partition(f'[[recording]]\nfile = "{path.name}"')
            text = head + tail.partition("\n\n")[2] if entry else text
    lab.write_text(text)


def add_response(simulator: Simulator, seed: int, recordings: Path) -> None:
    """Replace the dynamic recordings by a measured frequency response."""
    remove_dynamic_recordings(simulator, seed, recordings)
    files = list(recordings.glob("*.csv"))
    drives = [np.loadtxt(path, delimiter=",", skiprows=1)[:, 1] for path in files]
    amplitude_V = AMPLITUDE * float(np.ptp(np.concatenate(drives)))
    frequency_Hz, response = lock_in(simulator, seed, amplitude_V)
    table = np.column_stack([frequency_Hz, np.abs(response) * 1e6, np.degrees(np.angle(response))])
    heading = "Frequency [Hz],Magnitude [um/V],Phase [deg]"
    path = recordings / "response.csv"
    np.savetxt(path, table, delimiter=",", header=heading, comments="", fmt="%.6g")
    axis = collect(files, read_lab(recordings / "lab.toml")).recordings[0].axis
    with (recordings / "lab.toml").open("a") as lab:
        lab.write(f'\n[[recording]]\nfile = "response.csv"\naxis = "{axis}"\n')


def lock_in(simulator: Simulator, seed: int, amplitude_V: float) -> tuple[Array, Array]:
    """Measure the response [m/V] at single frequencies, with sines about the rest position."""
    library = simulator.library
    library.stage_step.argtypes = (ctypes.c_void_p, ctypes.c_double, *[ctypes.c_void_p] * 2)
    plant, rest_V, _ = simulator.open_stage(seed, 5)
    measured, position = ctypes.c_double(), ctypes.c_double()
    # The rest position may be an end of the drive range.
    centre_V = rest_V + 0.1 * np.copysign(amplitude_V, -rest_V)
    frequency_Hz, responses = np.geomspace(LOWEST_Hz, HIGHEST_Hz, LINES), []
    for f in frequency_Hz:
        settling = round(max(SETTLING_s * RATE_Hz, 2 * RATE_Hz / f))
        ticks = settling + round(max(PERIODS, f * 0.02) * RATE_Hz / f)
        turns = f * np.arange(ticks) / RATE_Hz
        drive_V = centre_V + amplitude_V * np.sin(2.0 * np.pi * turns)
        readings = np.empty(ticks)
        for k, value in enumerate(drive_V.tolist()):
            library.stage_step(plant, value, ctypes.byref(measured), ctypes.byref(position))
            readings[k] = measured.value
        # The value that a call returns is measured one tick after its drive was written.
        delayed = np.concatenate([readings[:1], readings[:-1]])
        phasor = np.exp(2j * np.pi * turns)
        columns = np.stack([phasor, phasor.conj(), np.ones(ticks), turns], axis=1)[settling:]
        output, input_ = (
            np.linalg.lstsq(columns, values[settling:].astype(complex), rcond=None)[0][0]
            for values in (delayed, drive_V)
        )
        responses.append(output / input_)
    library.stage_close(plant)
    return frequency_Hz, np.array(responses)


def main() -> None:
    """Evaluate every stage twice, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=NAMES)
    parser.add_argument("--stages", default="201-206")
    parser.add_argument("--out", type=Path, default=None)
    options = parser.parse_args()
    cases = (("with", add_response), ("without", remove_dynamic_recordings))
    for name in [options.only] if options.only else NAMES:
        for seed in seed_range(options.stages):
            for case, prepare in cases:
                folder = None if options.out is None else options.out / case
                print(_line(case, evaluate_stage(name, seed, folder, prepare)), flush=True)


def _line(case: str, stage: StageResult) -> str:
    head = (
        f"{stage.simulator} {stage.seed} {case}: {stage.law}, mode {stage.mode_Hz:.0f} Hz, "
        f"Q {stage.quality:.0f}: "
    )
    if not stage.ships:
        return f"{head}does not ship: {stage.reason[:200]}"
    return head + stage.loop_summary(decimals=1)


if __name__ == "__main__":
    main()
