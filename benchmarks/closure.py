"""Closure: error of the fitted model over the true noise, on healthy stages of every law.

    python -m benchmarks.closure [--laws dahl,duhem] [--cases 1] [--seeds 7100000] [--own]

The stages are those of ``benchmarks.zoo``, with instruments and recordings of their own, the drive
cycled before each recording. ``--own`` replaces the ceramic by the forward model of the fit: what
is left there is the estimator's fault alone. Printed for each stage: error in sample corrected for
the number of parameters, and on left-out blocks, with loop shape and without, over the noise.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.zoo.score import recorded
from benchmarks.zoo.stages import NAMES, drawn, stage
from piezoid.identification.fit import axes_of, fit_axis
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.records.recording import Quantity, Recording

AIMS = (("explained", 1.5, 0.95), ("held out", 1.5, 0.9))


def stages(
    laws: Sequence[str], cases: int, first: int, *, is_own: bool
) -> Iterator[tuple[str, AxisModel, float, float]]:
    """Yield name, fitted axis, noise [m] and processor time [s]."""
    for number in range(cases):
        for law in laws:
            asked = stage(law, "healthy", number, first)
            campaign = drawn(asked, settled=True)
            recordings, lab = recorded(campaign)
            noise_m, axis = campaign.answer.noise_rms_m, axes_of(recordings)[0]
            if is_own:
                model = fit_axis(recordings, axis, lab)
                rng = np.random.default_rng(asked.seed)
                recordings = tuple(
                    simulated(model, r, noise_m, rng)
                    for r in recordings
                    if any(start.recording == r.name for start in model.starts)
                )
            begun_s = time.process_time()
            model = fit_axis(recordings, axis, lab)
            yield f"{law} {asked.seed}", model, noise_m, time.process_time() - begun_s


def simulated(
    model: AxisModel, recording: Recording, noise_m: float, rng: np.random.Generator
) -> Recording:
    """Return a recording with the response of a model and white noise as its displacement."""
    moved_m = simulate_recording(model, recording)
    moved_m = np.where(np.isfinite(moved_m), moved_m, recording.displacement_m(model.axis))
    read_m = moved_m + noise_m * rng.standard_normal(recording.samples)
    channels = tuple(
        replace(channel, values=read_m)
        if channel.quantity is Quantity.DISPLACEMENT and channel.axis == model.axis
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


def main() -> None:
    """Print every stage, and how many reach the aims."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--cases", type=int, default=1, help="of each law")
    parser.add_argument("--seeds", type=int, default=7_100_000, help="the first of them")
    parser.add_argument("--own", action="store_true", help="data of the fit's forward model")
    asked = parser.parse_args()
    ratios: dict[str, list[float]] = {name: [] for name, _, _ in AIMS}
    laws = asked.laws.split(",")
    for name, axis, noise_m, time_s in stages(laws, asked.cases, asked.seeds, is_own=asked.own):
        quality, plain = axis.quality, axis.without_loop_shape().quality
        found = (quality.explained_rms_m / noise_m, quality.held_out_rms_m / noise_m)
        before = (plain.explained_rms_m / noise_m, plain.held_out_rms_m / noise_m)
        for values, ratio in zip(ratios.values(), found, strict=True):
            values.append(ratio)
        print(
            f"{name:32} explained {found[0]:6.2f} (plays {before[0]:6.2f})  "
            f"held out {found[1]:6.2f} (plays {before[1]:6.2f})  {time_s:5.1f} s",
            flush=True,
        )
    for (name, most, share), values in zip(AIMS, ratios.values(), strict=True):
        good = sum(value <= most for value in values)
        print(f"{name}: {good} of {len(values)} at most {most} (aim {share:.0%})")


if __name__ == "__main__":
    main()
