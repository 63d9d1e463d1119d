"""A 3 x 3 modal model of a piezo steering mirror, judged on realisations it has not seen.

    python benchmarks/steering_mirror.py FOLDER [--modes 16,17,18] [--hold band_limited]

FOLDER holds u_100mV_train.npy, y_100mV_train.npy and the same for 300mV, as published by
M. Floren et al. (ISMA-USD 2024): (samples, channels, realisations, periods) at 6400 Hz, V and m.
Fitted on realisations 1 to 4, judged on 5 and 6; the measured response is judged beside it, and
once more fitted on five realisations and judged on the sixth, which is the best it can do.

The publishers' resonances of 999 and 987 Hz are the lines at which the measured response of the
first path is largest. Single lines are known to 2.5 % there and the top is flat: smoothed over
30 Hz it lies at 1001.3 and 989.1 Hz, and the mode itself, common to all nine paths, at 1002.9 and
990.6 Hz (100 and 300 mV).
"""

import argparse
import time
from pathlib import Path

import numpy as np

from benchmarks.amplitude_dependence import AmplitudeDependence, extrapolate_mode
from benchmarks.structure_choice import (
    StructureChoice,
    choose_structure,
    relative_rms,
)
from piezoid.identification.dynamics.fit_dynamics import Declaration
from piezoid.identification.dynamics.frequency_response import FrequencyResponse
from piezoid.identification.dynamics.maximum_likelihood import phase_delay_s, resolved_modes
from piezoid.identification.dynamics.modal import LinearDynamics
from piezoid.identification.dynamics.modal_basis import Structure
from piezoid.identification.dynamics.periodic_estimate import PeriodicData, estimate_response

RATE_HZ = 6400.0
AXES = ("1", "2", "3")


def read(folder: Path, level: str) -> PeriodicData:
    """Read one level."""
    return PeriodicData(
        sampling_rate_Hz=RATE_HZ,
        inputs=AXES,
        outputs=AXES,
        voltage_V=np.load(folder / f"u_{level}_train.npy"),
        displacement_m=np.load(folder / f"y_{level}_train.npy"),
    )


def leave_one_out(data: PeriodicData) -> float:
    """Return the mean relative rms of the measured response on the realisation left out."""
    lines = data.excited_lines()
    errors = []
    for out in range(6):
        fitted = estimate_response(data.select([r for r in range(6) if r != out]), lines=lines)
        errors.append(relative_rms(fitted.response, fitted.frequency_Hz, data.select([out])))
    return float(np.mean(errors))


def judge(folder: Path, level: str, modes: list[int], declaration: Declaration) -> StructureChoice:
    """Fit all structures at one level and print the table."""
    data = read(folder, level)
    train, held_out = data.select([0, 1, 2, 3]), data.select([4, 5])
    measured = estimate_response(train, lines=data.excited_lines())
    direct = relative_rms(measured.response, measured.frequency_Hz, held_out)
    print(f"{level}: {measured.is_rejected.any(axis=1).sum()} of {len(measured.response)} lines")
    print(f"  rejected at {measured.frequency_Hz[measured.is_rejected.any(axis=1)].round(1)} Hz")
    print(f"  measured response, 4 realisations: {100 * direct:.2f} %")
    print(f"  measured response, leave one out:  {100 * leave_one_out(data):.2f} %")
    began, cpu = time.perf_counter(), time.process_time()
    structures = [Structure(modes=n, rate_gains=True, direct=True) for n in modes]
    choice = choose_structure(measured, held_out, structures, declaration)
    for trial in choice.trials:
        print(
            f"  {trial.structure.modes} modes, {trial.parameters} parameters: "
            f"{100 * trial.held_out_relative_rms:.2f} %, cost {trial.cost_ratio:.2f} of expected"
            f" {trial.reason}"
        )
    model = choice.chosen
    near = int(np.argmin(np.abs(model.mode_frequency_Hz - 995)))
    low_Hz, high_Hz = model.mode_frequency_interval_Hz()[near]
    early_us, late_us = 1e6 * model.delay_interval_s()
    print(
        f"  chosen: {choice.structure.modes} modes, {resolved_modes(model).sum()} of them resolved"
    )
    print(f"  delay {1e6 * model.delay_s:.1f} us [{early_us:.1f}, {late_us:.1f}]")
    slow_us = 1e6 * np.diag(phase_delay_s(model, 300.0))
    print(
        f"  at 300 Hz each axis follows its own drive by {slow_us.round(1)} us, all lags together"
    )
    print(
        f"  mode near 1 kHz: {model.mode_frequency_Hz[near]:.2f} Hz [{low_Hz:.2f}, {high_Hz:.2f}]"
    )
    tell_peak(measured, model)
    print(f"  all modes: {model.mode_frequency_Hz.round(1)} Hz")
    print(f"  dampings:  {model.mode_damping.round(4)}")
    print(
        f"  {time.perf_counter() - began:.0f} s by the clock, "
        f"{time.process_time() - cpu:.0f} s of processor"
    )
    return choice


def tell_peak(measured: FrequencyResponse, model: LinearDynamics) -> None:
    """Print where the response from the first piezo to the first displacement is largest.

    That line is what the publishers call the resonance. It is not the frequency of a mode: modes
    overlap here, and a sum of two peaks below the upper one.
    """
    lines_Hz = measured.frequency_Hz
    seen_Hz = lines_Hz[np.abs(measured.response[:, 0, 0]).argmax()]
    modelled_Hz = lines_Hz[np.abs(model.response_as_measured(lines_Hz)[:, 0, 0]).argmax()]
    print(
        f"  largest gain of path 1 from 1: measured at {seen_Hz:.1f} Hz, "
        f"model {modelled_Hz:.1f} Hz"
    )


def tell_levels(found: AmplitudeDependence) -> None:
    """Print how a mode moves with the level."""
    trend = found.frequency
    low, high = trend.at_zero_interval
    print(
        f"mode {found.frequency_Hz.round(2)} Hz at {found.drive_rms_V.round(3)} V rms: "
        f"{trend.at_zero:.2f} Hz [{low:.2f}, {high:.2f}] at no drive, "
        f"{100 * trend.change_per_V:.2f} % per volt; damping {found.damping.round(4)}"
    )


def main() -> None:
    """Run both levels."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--modes", default="16,17,18,20")
    parser.add_argument("--hold", choices=["band_limited", "zero_order"], default="band_limited")
    given = parser.parse_args()
    modes = [int(n) for n in given.modes.split(",")]
    declaration = Declaration(hold=given.hold)
    levels = [judge(given.folder, level, modes, declaration) for level in ("100mV", "300mV")]
    for near_Hz in (640, 814, 922, 997, 1320, 2130):
        tell_levels(extrapolate_mode([choice.chosen for choice in levels], near_Hz))


if __name__ == "__main__":
    main()
