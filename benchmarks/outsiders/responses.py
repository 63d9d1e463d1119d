"""Stages of outsiders whose recordings show no mode: a loop with a measured response, and without.

    python -m benchmarks.outsiders.responses [--only alder] [--stages 201-206]

Of each stage's recordings only those are kept that excite no dynamics. The response is then
measured on the simulator's own plant as a lock-in does, with small sines about the place of rest,
by the controller's converters, and given to the fit as a CSV of its own.
"""

import argparse
import ctypes
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.outsiders.lateral import StageResult, judge
from benchmarks.outsiders.simulators import NAMES, RATE_Hz, Simulator
from piezoid.identification.dynamics.behind_hysteresis import excites_dynamics
from piezoid.numerics.arrays import Array
from piezoid.records.collection import collect
from piezoid.records.lab import read_lab

SHARE = 0.01  # of the recorded drive: the amplitude of the sines
LINES = 160
LOWEST_Hz, HIGHEST_Hz = 4.0, 6000.0
SETTLED_s = 0.06  # decay of a mode of 300 Hz and quality 60: a rest of e^-1 each
PERIODS = 8


def slow_only(_: Simulator, __: int, recordings: Path) -> None:
    """Take away what excites dynamics, and its entries in lab.toml."""
    kept = recordings / "lab.toml"
    text = kept.read_text()
    for path in sorted(recordings.glob("*.csv")):
        recording = collect([path]).recordings[0]
        if excites_dynamics([recording], recording.axis):
            path.unlink()
            block = f'[[recording]]\nfile = "{path.name}"'
            head, _, rest = text.partition(block)
            text = head + rest.partition("\n\n")[2] if block in text else text
    kept.write_text(text)


def with_response(made: Simulator, seed: int, recordings: Path) -> None:
    """Add a measured response to what is left of the recordings."""
    slow_only(made, seed, recordings)
    drives = [np.loadtxt(p, delimiter=",", skiprows=1)[:, 1] for p in recordings.glob("*.csv")]
    amplitude_V = SHARE * float(np.ptp(np.concatenate(drives)))
    frequency_Hz, response = lock_in(made, seed, amplitude_V)
    table = np.column_stack([frequency_Hz, np.abs(response) * 1e6, np.degrees(np.angle(response))])
    heading = "Frequency [Hz],Magnitude [um/V],Phase [deg]"
    path = recordings / "response.csv"
    np.savetxt(path, table, delimiter=",", header=heading, comments="", fmt="%.6g")
    slow = [p for p in recordings.glob("*.csv") if p != path]
    axis = collect(slow, read_lab(recordings / "lab.toml")).recordings[0].axis
    with (recordings / "lab.toml").open("a") as lab:
        lab.write(f'\n[[recording]]\nfile = "response.csv"\naxis = "{axis}"\n')


def lock_in(made: Simulator, seed: int, amplitude_V: float) -> tuple[Array, Array]:
    """Drive small sines about rest, one after the other, and compare reading with drive."""
    library = made.library
    library.stage_step.argtypes = (ctypes.c_void_p, ctypes.c_double, *[ctypes.c_void_p] * 2)
    plant = library.stage_open(seed, 5)
    volts, rest = ctypes.c_double(), ctypes.c_double()
    library.stage_rest(plant, ctypes.byref(volts), ctypes.byref(rest))
    middle_V, reading, position = volts.value, ctypes.c_double(), ctypes.c_double()
    found, held = [], []
    inside = 0.1 * np.copysign(amplitude_V, -middle_V)  # rest may be an end of the drive
    for f in np.geomspace(LOWEST_Hz, HIGHEST_Hz, LINES):
        settled = round(max(SETTLED_s * RATE_Hz, 2 * RATE_Hz / f))
        ticks = settled + round(max(PERIODS, f * 0.02) * RATE_Hz / f)
        turns = f * np.arange(ticks) / RATE_Hz
        drive = middle_V + inside + amplitude_V * np.sin(2.0 * np.pi * turns)
        shown = np.empty(ticks)
        for k, value in enumerate(drive.tolist()):
            library.stage_step(plant, value, ctypes.byref(reading), ctypes.byref(position))
            shown[k] = reading.value
        # What a call returns is read a tick after its voltage was written.
        late = np.concatenate([shown[:1], shown[:-1]])
        turning = np.exp(2j * np.pi * turns)
        columns = np.stack([turning, turning.conj(), np.ones(ticks), turns], axis=1)[settled:]
        moved, driven = (
            np.linalg.lstsq(columns, values[settled:].astype(complex), rcond=None)[0][0]
            for values in (late, drive)
        )
        held.append(f)
        found.append(moved / driven)
    library.stage_close(plant)
    return np.array(held), np.array(found)


def main() -> None:
    """Judge every stage twice, and print a line for each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", choices=NAMES)
    parser.add_argument("--stages", default="201-206")
    parser.add_argument("--out", type=Path, default=None)
    asked = parser.parse_args()
    first, _, last = asked.stages.partition("-")
    for name in [asked.only] if asked.only else NAMES:
        for seed in range(int(first), int(last or first) + 1):
            for said, prepare in (("with", with_response), ("without", slow_only)):
                folder = None if asked.out is None else asked.out / said
                print(_line(said, judge(name, seed, folder, prepare)), flush=True)


def _line(said: str, r: StageResult) -> str:
    r = replace(r, reason=r.reason[:200])
    head = f"{r.simulator} {r.seed} {said}: {r.law}, mode {r.mode_Hz:.0f} Hz, Q {r.quality:.0f}: "
    if not r.ships:
        return f"{head}does not ship: {r.reason}"
    return (
        f"{head}{'stable' if r.stable else 'UNSTABLE'}, {r.bandwidth_Hz:.1f} Hz, at 10 Hz "
        f"{r.error_10_m * 1e9:.1f} nm of {r.none_10_m * 1e9:.0f} nm; bound "
        f"{r.bound_broken} of {r.bound_runs} broken, worst {r.worst_to_bound:.2f}"
    )


if __name__ == "__main__":
    main()
