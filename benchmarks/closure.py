"""Closure: error of the final model over the true noise, on stages of every law.

    python -m benchmarks.closure [--laws dahl,duhem] [--kinds healthy,triple] [--cases 1]
                                 [--seeds 7100000] [--own]

The stages are those of ``benchmarks.zoo``, with drives in a steady cycle before each recording.
Healthy ones are fitted, those with hidden effects are diagnosed as well. ``--own`` replaces the
displacement by a simulation with the final model, so that only errors of the estimator remain.
Printed for each stage, over the noise of sensor and converter: error in sample, corrected for the
number of parameters, and error on held-out blocks, both with loop shape and without (plays).
"""

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from benchmarks.zoo.command_line import stage_parser
from benchmarks.zoo.score import read_campaign
from benchmarks.zoo.stages import KINDS, NAMES, draw_stage, noise_floor_m, stage_requests
from piezoid.diagnosis.diagnose import diagnose
from piezoid.identification.fit import axes_of, fit_axis
from piezoid.identification.model import AxisModel
from piezoid.identification.simulation import simulate_recording
from piezoid.records.lab import Lab
from piezoid.records.recording import Quantity, Recording

AIMS = (("explained", 1.5, 0.95), ("held out", 1.5, 0.9))  # name, limit, share of stages


def fit_stages(
    laws: Sequence[str], kinds: Sequence[str], cases: int, first: int, *, is_own: bool
) -> Iterator[tuple[str, AxisModel, float, float]]:
    """Yield name, fitted axis, noise [m] and processor time [s]."""
    for request in stage_requests(laws, kinds, cases, first):
        campaign = draw_stage(request, settled=True)
        recordings, lab = read_campaign(campaign)
        noise_m, axis = noise_floor_m(campaign), axes_of(recordings)[0]
        if is_own:
            model = final_model(recordings, axis, lab, has_effects=bool(request.hidden))
            rng = np.random.default_rng(request.seed)
            recordings = tuple(
                with_simulation(model, recording, noise_m, rng)
                for recording in recordings
                if any(start.recording == recording.name for start in model.starts)
            )
        start_s = time.process_time()
        model = final_model(recordings, axis, lab, has_effects=bool(request.hidden))
        name = " ".join([request.law, str(request.seed), *sorted(request.hidden)])
        yield name, model, noise_m, time.process_time() - start_s


def final_model(
    recordings: Sequence[Recording], axis: str, lab: Lab, *, has_effects: bool
) -> AxisModel:
    """Return the fit of an axis, or with hidden effects the model with all findings."""
    if not has_effects:
        return fit_axis(recordings, axis, lab)
    model = diagnose(recordings, axis=axis, lab=lab).model
    assert model is not None
    return model


def with_simulation(
    model: AxisModel, recording: Recording, noise_m: float, rng: np.random.Generator
) -> Recording:
    """Return a recording whose displacement is the response of a model plus white noise."""
    response_m = simulate_recording(model, recording)
    response_m = np.where(
        np.isfinite(response_m), response_m, recording.displacement_m(model.axis)
    )
    reading_m = response_m + noise_m * rng.standard_normal(recording.samples)
    channels = tuple(
        replace(channel, values=reading_m)
        if channel.quantity is Quantity.DISPLACEMENT and channel.axis == model.axis
        else channel
        for channel in recording.channels
    )
    return replace(recording, channels=channels)


def main() -> None:
    """Print every stage, and how many reach the aims."""
    parser = stage_parser(__doc__, cases=1, first=7_100_000)
    parser.add_argument("--laws", default=",".join(NAMES))
    parser.add_argument("--kinds", default="healthy", help=", ".join(KINDS))
    parser.add_argument("--own", action="store_true", help="data of the forward model of the fit")
    options = parser.parse_args()
    ratios: list[tuple[float, float]] = []
    laws, kinds = options.laws.split(","), options.kinds.split(",")
    stages = fit_stages(laws, kinds, options.cases, options.seeds, is_own=options.own)
    for name, axis, noise_m, time_s in stages:
        (explained, held_out), (plays_explained, plays_held_out) = (
            (quality.explained_rms_m / noise_m, quality.held_out_rms_m / noise_m)
            for quality in (axis.quality, axis.without_loop_shape().quality)
        )
        ratios.append((explained, held_out))
        print(
            f"{name:40} explained {explained:6.2f} (plays {plays_explained:6.2f})  "
            f"held out {held_out:6.2f} (plays {plays_held_out:6.2f})  {time_s:5.1f} s",
            flush=True,
        )
    for (name, limit, share), values in zip(AIMS, zip(*ratios, strict=True), strict=True):
        count = sum(value <= limit for value in values)
        print(f"{name}: {count} of {len(values)} at most {limit} (aim {share:.0%})")


if __name__ == "__main__":
    main()
