"""A stage in the closed loop of its manufacturer: no hysteresis, but a low bandwidth.

    command -> servo of first order, 1 / (1 + s / w) -> displacement

If the command is recorded as the drive, the loops are wide because of the lag alone. A loop of
1 Hz with 10 Hz of bandwidth opens by 4 f T = 6.4 % of the stroke, as much as a soft ceramic.
"""

import numpy as np

from piezoid_datasets.virtual_lab import drives
from piezoid_datasets.virtual_lab.effects.effect import Act, Place
from piezoid_datasets.virtual_lab.effects.sensor import filtered
from piezoid_datasets.virtual_lab.plans import volts_of
from piezoid_datasets.virtual_lab.rig import draw_rig
from piezoid_datasets.virtual_lab.stage import Rows, Run, Stage, record
from piezoid_datasets.virtual_lab.truths.truth import Ceramic

RATE_Hz = 500.0
CYCLES = 6


def servo_stage(bandwidth_Hz: float, *, seed: int = 0, ceramic: Ceramic | None = None) -> Stage:
    """Return a stage that follows its command through a first-order servo.

    ceramic  without it the servo removes the hysteresis; with it the lag follows the ceramic
    """
    tau_s = 1.0 / (2.0 * np.pi * bandwidth_Hz)
    follow = Act(
        name="servo",
        place=Place.MECHANICS,
        change=lambda moved_m, scene, _: filtered(moved_m, tau_s, scene.rate_Hz),
    )
    linear = Ceramic(
        share=0.0, reversible_curve=lambda field: 0.5 * (field + 1.0), memory=np.zeros_like
    )
    rig = draw_rig(np.random.default_rng([seed, 10]), name=f"servo of {bandwidth_Hz:g} Hz")
    return Stage(rig=rig, ceramic=ceramic or linear, acts=(follow,), seed=seed)


def triangles(stage: Stage, frequencies_Hz: tuple[float, ...]) -> Rows:
    """Record triangles over the full range, ``CYCLES`` cycles of each frequency in turn."""
    shape = drives.rates(RATE_Hz, tuple((f, CYCLES) for f in frequencies_Hz), triangle=True)
    rig = stage.rig
    run = Run(
        name="triangles_" + "_".join(f"{f:g}".replace(".", "p") for f in frequencies_Hz),
        sampling_rate_Hz=RATE_Hz,
        command_V=volts_of(rig, shape),
        history_V=np.array([rig.drive_max_V, rig.drive_min_V]),
    )
    return record(stage, run)
