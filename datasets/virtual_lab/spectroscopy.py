"""A Z spectroscopy of a junction: current over height in both directions, as a Nanonis file.

The feedback is off while the tip retracts and returns. The simulation includes shot and Johnson
noise averaged over each reading, an offset of the amplifier, and a shift of the height.
"""

from dataclasses import dataclass

import numpy as np

from piezoid_datasets.virtual_lab.junction import Junction
from piezoid_datasets.virtual_lab.signals import Array

_POINTS = 200
_TRAVEL_DECAYS = 12.0  # e-folds of the current: from the set point to below the noise
_READING_s = 10e-3
_ELECTRON_C = 1.602176634e-19
_BOLTZMANN_J_PER_K = 1.380649e-23
_ROOM_K = 293.0
_JITTER_m = 0.3e-12  # of the gap, averaged over a reading
_BIAS_V = 0.05


@dataclass(frozen=True, kw_only=True, eq=False)
class Spectroscopy:
    """One sweep in each direction.

    height_m     (points,)  increases when the tip retracts
    forward_A    (points,)
    backward_A   (points,)
    offset_A     of the amplifier, in both directions
    shift_m      of the backward curve towards larger heights
    """

    height_m: Array
    forward_A: Array
    backward_A: Array
    offset_A: float
    shift_m: float

    def text(self) -> str:
        """Return the text of a Nanonis file."""
        rows = np.column_stack([self.height_m, self.forward_A, self.backward_A])
        lines = ["\t".join(f"{value:.9e}" for value in row) for row in rows]
        return (
            f"Experiment\tZ spectroscopy\t\nBias>Bias (V)\t{_BIAS_V:g}\t\n\n[DATA]\n"
            "Z rel (m)\tCurrent (A)\tCurrent [bwd] (A)\n" + "\n".join(lines) + "\n"
        )


def draw_spectroscopy(junction: Junction, rng: np.random.Generator) -> Spectroscopy:
    """Simulate a sweep of a junction from its set point outwards and back."""
    height_m = np.linspace(0.0, _TRAVEL_DECAYS / junction.decay_per_m, _POINTS)
    offset_A, shift_m = float(rng.normal(0.0, 2e-14)), float(rng.normal(0.0, 3e-12))
    return Spectroscopy(
        height_m=height_m,
        forward_A=_read(junction, height_m, rng) + offset_A,
        backward_A=_read(junction, height_m - shift_m, rng) + offset_A,
        offset_A=offset_A,
        shift_m=shift_m,
    )


def _read(junction: Junction, height_m: Array, rng: np.random.Generator) -> Array:
    gap_m = height_m + _JITTER_m * rng.standard_normal(len(height_m))
    current_A = junction.set_point_A * np.exp(-junction.decay_per_m * gap_m)
    band_Hz = 0.5 / _READING_s
    thermal = 4.0 * _BOLTZMANN_J_PER_K * _ROOM_K * band_Hz / junction.current_gain_V_per_A
    noise_A = np.sqrt(2.0 * _ELECTRON_C * current_A * band_Hz + thermal)
    return np.asarray(current_A + noise_A * rng.standard_normal(len(height_m)))
