"""What a fit may not depend on: units, signs, zeros, the order of files, the rate, the process."""

import os
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np

from piezoid.identification.actuator_model import ActuatorModel
from piezoid.identification.fit import fit
from piezoid.identification.hysteresis.estimate import estimate_axis
from piezoid.identification.hysteresis.pieces import Rig
from piezoid.identification.model import AxisModel
from piezoid.identification.store import write_model
from piezoid.numerics.arrays import Array
from piezoid.records.recording import Recording
from tests.identification.hysteresis.stages import RATE_Hz, decaying, recording, wandering
from tests.identification.hysteresis.test_estimate import stage

ROUNDING = 1e-9  # of the stroke: some thousand times the rounding of one simulation
PROBE_V = decaying(8)


@cache
def measured() -> tuple[Array, Array]:
    drive = decaying(7, per_unit=20)
    return drive, stage(drive, np.random.default_rng(5))


@cache
def stage_model() -> ActuatorModel:
    return fit([recording(*measured())])


def fitted() -> AxisModel:
    return stage_model()["x"]


def shape_of(model: AxisModel, probe_V: Array = PROBE_V) -> Array:
    """What the model does from its de-poled state, from where it begins."""
    response = model.simulate(probe_V, RATE_Hz, model.virgin_memory_V)
    return np.asarray(response - response[0])


def test_powers_of_two_as_units_change_no_bit():
    drive, response = measured()
    other = fit([recording(drive * 2.0**10, response * 2.0**-20)])["x"]
    plays = fitted().hysteresis.plays
    np.testing.assert_array_equal(other.hysteresis.plays.threshold, plays.threshold * 2.0**10)
    np.testing.assert_array_equal(other.hysteresis.plays.weight, plays.weight * 2.0**-30)
    assert other.quality.held_out_rms_m == fitted().quality.held_out_rms_m * 2.0**-20
    assert other.lag == fitted().lag


def test_kilovolts_picometres_signs_and_zeros_change_no_more_than_rounding():
    drive, response = measured()
    kilovolt, picometre, bias = 1e-3, 1e12, 64.0
    other = fit([recording(bias - drive * kilovolt, response * -picometre - 3e5)])["x"]
    assert other.polarity == fitted().polarity == 1  # both have turned round
    shape = shape_of(other, bias - PROBE_V * kilovolt) / -picometre
    np.testing.assert_allclose(
        shape, shape_of(fitted()), atol=ROUNDING * np.ptp(shape_of(fitted()))
    )
    quality, plain = other.quality, fitted().quality
    np.testing.assert_allclose(quality.held_out_rms_m / picometre, plain.held_out_rms_m, rtol=1e-6)
    np.testing.assert_allclose(
        other.uncertainty.loop_width_m, np.multiply(fitted().uncertainty.loop_width_m, picometre),
        rtol=1e-4,
    )  # fmt: skip


def two_recordings() -> list[Recording]:
    """A decaying sweep and a walk of one stage, whose fit has a second place it may end in."""
    rng = np.random.default_rng(5)
    drives = (decaying(6, per_unit=12), wandering(rng, 5)[::4])
    return [recording(u, stage(u, rng), f"{k}.csv") for k, u in enumerate(drives)]


@cache
def fitted_to_both() -> AxisModel:
    return estimate_axis(two_recordings(), "x", Rig())


def test_a_fit_is_no_worse_on_its_own_rows_than_on_rows_left_out():
    """From its convex start it ended at 26 nm for a held-out 3.4; the folds knew better."""
    quality = fitted_to_both().quality
    assert quality.rms_m < quality.held_out_rms_m < 4e-9


def test_the_order_of_the_recordings_does_not_matter():
    first = fitted_to_both()
    second = estimate_axis(two_recordings()[::-1], "x", Rig())
    assert [start.recording for start in second.starts] == ["1.csv", "0.csv"]
    np.testing.assert_allclose(
        shape_of(first), shape_of(second), atol=ROUNDING * np.ptp(shape_of(first))
    )
    np.testing.assert_allclose(
        first.quality.held_out_rms_m, second.quality.held_out_rms_m, rtol=1e-6
    )


def test_half_the_samples_give_the_same_stage_within_what_either_is_sure_of():
    drive, response = measured()
    thinned = fit([recording(drive[::2], response[::2], rate_Hz=RATE_Hz / 2)])["x"]
    coarse = thinned.simulate(PROBE_V[::2], RATE_Hz / 2, thinned.virgin_memory_V)
    apart = (coarse - coarse[0]) - shape_of(fitted())[::2]
    sure_m = np.hypot(thinned.quality.held_out_rms_m, fitted().quality.held_out_rms_m)
    assert np.sqrt(np.mean((apart - apart.mean()) ** 2)) < 2 * sure_m
    assert abs(thinned.lag.time_s - fitted().lag.time_s) < 0.1 * fitted().lag.time_s


PROGRAMME = """
import sys
from piezoid.identification.store import write_model
from tests.identification.test_invariance import stage_model
sys.stdout.buffer.write(write_model(stage_model()))
"""


def test_another_process_gives_the_same_bytes():
    # Other numbers of threads: benchmarks/same_bytes.py, as waiting threads cost a busy machine.
    done = subprocess.run(
        [sys.executable, "-c", PROGRAMME],
        cwd=Path(__file__).parents[2],
        env=os.environ | {"PYTHONHASHSEED": "random"},
        capture_output=True,
        check=True,
    )
    assert done.stdout == write_model(stage_model())
