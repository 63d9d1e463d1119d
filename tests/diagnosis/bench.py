"""A healthy campaign of the virtual laboratory as recordings, and the view of them."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache

from benchmarks.zoo.score import read_campaign as recorded
from benchmarks.zoo.stages import KINDS, NAMES, PER_KIND, PER_LAW, stage
from benchmarks.zoo.stages import draw_stage as drawn
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.diagnosis.residual_view import View
from piezoid.records.lab import Lab
from piezoid.records.recording import Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign

PLANS = ("sweep", "rates", "staircase", "chirp", "other_axis")


def causes(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the findings that accuse the stage: the shape of its loops is no fault."""
    return tuple(name for name in diagnosis.names if name != "loop_shape")


def effects_of(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return the findings that name an effect of the stage or its instruments.

    Loop shape and something else say what the class of hysteresis leaves on this stage.
    """
    rest = ("loop_shape", "something_else")
    return tuple(finding for finding in diagnosis.findings if finding.effect not in rest)


def thinned(recordings: Iterable[Recording], every: int) -> tuple[Recording, ...]:
    """Return the recordings with every n-th sample: the same stage, quicker to diagnose."""
    return tuple(
        replace(
            recording,
            sampling_rate_Hz=recording.sampling_rate_Hz / every,
            channels=tuple(
                replace(channel, values=channel.values[::every]) for channel in recording.channels
            ),
        )
        for recording in recordings
    )


def recorded_zoo_stage(law: str, kind: str, seed: int) -> tuple[tuple[Recording, ...], Lab, float]:
    """Return the recordings of a stage of the zoo, its declarations and its noise, rms in m."""
    offset = NAMES.index(law) * PER_LAW + list(KINDS).index(kind) * PER_KIND
    campaign = drawn(stage(law, kind, 0, seed - offset))
    return (*recorded(campaign), campaign.answer.noise_rms_m)


@cache
def healthy() -> tuple[tuple[Recording, ...], Lab]:
    return recorded(draw_campaign(20, truth="bouc_wen", plans=PLANS))


def view_of_recordings(recordings: tuple[Recording, ...], lab: Lab) -> View:
    return view_on(recordings, axis="x", lab=lab)


@cache
def healthy_view() -> View:
    return view_of_recordings(*healthy())
