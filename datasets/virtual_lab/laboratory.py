"""A laboratory: its instruments, and habits that are not faults.

A diagnosis must not report any of these: amplifiers and sensors with declared bandwidths, noise,
drives that were cycled and then moved before a recording, and another zero in every file. Other
axes without coupling and holds without creep are plans (``plans.PLANS``).
"""

from dataclasses import dataclass, replace

import numpy as np

from piezoid_datasets.virtual_lab.effects.effect import Act, Place, Scene
from piezoid_datasets.virtual_lab.rig import Rig
from piezoid_datasets.virtual_lab.signals import Array

ZERO_SHARE = 0.02  # of the stroke: standard deviation of the zero of a file
SETTLED = 30  # cycles after which all laws of the zoo are periodic up to rounding


@dataclass(frozen=True, kw_only=True)
class Laboratory:
    """Instruments and habits of one laboratory.

    amplifier_bandwidth_Hz, sensor_bandwidth_Hz  first-order, declared in lab.toml
    noise_share   rms of the sensor noise, relative to the stroke
    cycles        smallest and largest number of full cycles before a recording
    most_turns    largest number of turning points after the cycles
    moves_zero    whether the zero differs between files
    """

    amplifier_bandwidth_Hz: float
    sensor_bandwidth_Hz: float
    noise_share: float
    cycles: tuple[int, int]
    most_turns: int
    moves_zero: bool

    def furnished(self, rig: Rig) -> Rig:
        """Return a rig with the instruments of this laboratory."""
        return replace(
            rig,
            amplifier_bandwidth_Hz=self.amplifier_bandwidth_Hz,
            sensor_bandwidth_Hz=self.sensor_bandwidth_Hz,
            noise_rms_m=self.noise_share * rig.stroke_m,
        )

    def past_V(self, rig: Rig, rng: np.random.Generator) -> Array:
        """Return the turning points before a recording: full cycles, then a shrinking sequence."""
        cycles = int(rng.integers(self.cycles[0], self.cycles[1] + 1))
        turns = int(rng.integers(0, self.most_turns + 1))
        middle_V = 0.5 * (rig.drive_min_V + rig.drive_max_V)
        reach_V = rig.drive_max_V - middle_V
        shrinking = np.sort(rng.uniform(0.05, 1.0, turns))[::-1] * (-1.0) ** np.arange(turns)
        cycles_V = np.array([rig.drive_max_V, rig.drive_min_V] * cycles)
        return np.concatenate((cycles_V, middle_V + reach_V * shrinking))

    @property
    def settled(self) -> "Laboratory":
        """The same laboratory, but with cycles until the loop is periodic."""
        return replace(self, cycles=(SETTLED, SETTLED), most_turns=0)

    @property
    def acts(self) -> tuple[Act, ...]:
        """Acts of the laboratory on every reading."""
        if not self.moves_zero:
            return ()

        def move_zero(reading_m: Array, scene: Scene, rng: np.random.Generator) -> Array:
            return reading_m + ZERO_SHARE * scene.rig.stroke_m * float(rng.standard_normal())

        return (Act(name="zero of the file", place=Place.SENSOR, change=move_zero),)


def draw_laboratory(rng: np.random.Generator) -> Laboratory:
    """Draw a laboratory with noise of 0.02 to 0.1 % of the stroke and random bandwidths."""
    return Laboratory(
        amplifier_bandwidth_Hz=float(np.round(np.exp(rng.uniform(*np.log((1.5e3, 8e3)))), -1)),
        sensor_bandwidth_Hz=float(np.round(np.exp(rng.uniform(*np.log((4e3, 15e3)))), -1)),
        noise_share=float(np.exp(rng.uniform(*np.log((2e-4, 1e-3))))),
        cycles=(1, int(rng.integers(1, 5))),
        most_turns=int(rng.integers(0, 7)),
        moves_zero=bool(rng.random() < 0.5),
    )
