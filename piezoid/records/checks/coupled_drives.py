"""Report axes whose displacement several drives move by comparable amounts.

    Y_i(f) = sum over axes j of H_ij(f) U_j(f)

H is fitted by least squares to bands of neighbouring lines, in which it hardly changes. The
contribution of a drive is the rms of H_ij U_j. Nothing is reported for collinear drives.
"""

from collections.abc import Mapping

import numpy as np

from piezoid.numerics.arrays import Array, ComplexArray
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording
from piezoid.statement import Statement, finding

MIN_SHARE = 0.3  # of the contribution of the axis' own drive; parasitic coupling is 0.01 to 0.1
MIN_EXPLAINED = 0.5  # of the power that its own drive does not explain; the rest is hysteresis
LINES_PER_DRIVE = 8  # in a band
MIN_POWER = 1e-5  # of the strongest line of all drives: weaker lines are noise
MAX_CONDITION = 30.0  # of the drives in a band, each scaled to rms 1
MAX_SAMPLES = 1 << 17


def check_coupled_drives(recording: Recording, lab: Lab) -> list[Statement]:
    """Report drives that move the displacement of another axis, unless lab.toml couples axes."""
    drives = {
        channel.axis: channel.values
        for channel in recording.channels
        if channel.quantity is Quantity.VOLTAGE and np.ptp(channel.values) > 0.0
    }
    axes = [axis for axis in recording.complete_axes if axis in drives]
    if lab.coupled.axes or len(axes) < 2:
        return []
    longest = max(recording.pieces, key=lambda piece: piece.stop - piece.start)
    part = slice(longest.start, min(longest.stop, longest.start + MAX_SAMPLES))
    inputs = {axis: drives[axis][part] for axis in axes}
    shares = {
        (axis, drive): share
        for axis in axes
        for drive, share in drive_shares(
            inputs, recording.displacement_m(axis)[part], axis
        ).items()
    }
    if not shares:
        return []
    coupled = [axis for axis in axes if any(axis in pair for pair in shares)]
    pairs = ", ".join(
        f"{axis} by the drive of {drive} {100 * share:.0f} % as far as by its own"
        for (axis, drive), share in shares.items()
    )
    names = ", ".join(f'"{axis}"' for axis in coupled)
    text = (
        f"Several drives move one displacement: {pairs}. Separate models of the axes are "
        f"invalid. Write into lab.toml: [coupled] axes = [{names}]"
    )
    return [finding("coupled_drives", text, axis=coupled[0], value=max(shares.values()), unit="1")]


def drive_shares(drives: Mapping[str, Array], displacement: Array, axis: str) -> dict[str, float]:
    """Return the motion caused by each drive, relative to that of the drive of the axis.

    drives        (samples,) by axis, any unit
    displacement  (samples,) of ``axis``

    Drives of other axes below ``MIN_SHARE`` are omitted.
    """
    names = [axis, *(name for name in drives if name != axis)]
    window = np.hanning(len(displacement))
    signals = np.stack([*(drives[name] for name in names), displacement])
    lines = np.fft.rfft((signals - signals.mean(axis=1, keepdims=True)) * window)
    lines /= np.sqrt(np.mean(np.abs(lines) ** 2, axis=1, keepdims=True)) + 1e-300
    power = np.max(np.abs(lines[:-1]) ** 2, axis=0)
    driven_lines = np.flatnonzero(power > MIN_POWER * power.max())
    bands = np.array_split(
        driven_lines, max(len(driven_lines) // (LINES_PER_DRIVE * len(names)), 1)
    )
    contributions, own_residual_power, residual_power = np.zeros(len(names)), 0.0, 0.0
    for band in bands:
        columns, target = lines[:-1, band].T, lines[-1, band]
        if np.linalg.cond(columns) > MAX_CONDITION:
            continue
        response, residual = _least_squares(columns, target)
        contributions += np.abs(response) ** 2 * np.sum(np.abs(columns) ** 2, axis=0)
        residual_power += residual
        own_residual_power += _least_squares(columns[:, :1], target)[1]
    is_explained = residual_power <= (1.0 - MIN_EXPLAINED) * own_residual_power
    if not is_explained or not contributions[0] > 0.0:
        return {}
    ratios = np.sqrt(contributions / contributions[0])
    return {
        name: float(ratio)
        for name, ratio in zip(names[1:], ratios[1:], strict=True)
        if ratio > MIN_SHARE
    }


def _least_squares(columns: ComplexArray, target: ComplexArray) -> tuple[ComplexArray, float]:
    """Return the coefficients and the power of the residual."""
    response = np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0], dtype=np.complex128)
    return response, float(np.sum(np.abs(target - columns @ response) ** 2))
