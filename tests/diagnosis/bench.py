"""Healthy campaigns of the virtual laboratory as recordings, and their residual views."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import cache

from benchmarks.zoo.score import read_campaign as read_campaign
from benchmarks.zoo.stages import KINDS, NAMES, PER_KIND, PER_LAW, draw_stage, stage
from piezoid.diagnosis.diagnose import view_on
from piezoid.diagnosis.diagnosis import Diagnosis, Finding
from piezoid.diagnosis.residual_view import View, with_tracks
from piezoid.numerics.arrays import Array
from piezoid.records.lab import Lab
from piezoid.records.recording import Channel, Quantity, Recording
from piezoid_datasets.virtual_lab.campaign import draw_campaign

NO_DECLARATIONS = Lab()
PLANS = ("sweep", "rates", "staircase", "chirp", "other_axis")


def causes(diagnosis: Diagnosis) -> tuple[str, ...]:
    """Return the findings except loop shape, which is not a fault of the stage."""
    return tuple(name for name in diagnosis.names if name != "loop_shape")


def effects_of(diagnosis: Diagnosis) -> tuple[Finding, ...]:
    """Return the findings that name an effect of the stage or its instruments."""
    return tuple(
        finding
        for finding in diagnosis.findings
        if finding.effect not in ("loop_shape", "something_else")
    )


def finding_of(diagnosis: Diagnosis, effect: str) -> Finding:
    """Return the only finding of an effect."""
    (finding,) = (finding for finding in diagnosis.findings if finding.effect == effect)
    return finding


def single_axis_recording(
    name: str, rate_Hz: float, voltage_V: Array, displacement_m: Array
) -> Recording:
    channels = tuple(
        Channel(quantity=quantity, axis="x", values=values, label=quantity.name)
        for quantity, values in (
            (Quantity.VOLTAGE, voltage_V),
            (Quantity.DISPLACEMENT, displacement_m),
        )
    )
    return Recording(name=name, digest="", axis="x", sampling_rate_Hz=rate_Hz, channels=channels)


def thinned(recordings: Iterable[Recording], every: int) -> tuple[Recording, ...]:
    """Return recordings with every n-th sample, which are faster to diagnose."""
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


def with_fewer_rows(view: View, every: int) -> View:
    """Return a view that fits every n-th of its rows; unlike thinned signals, all speeds stay."""
    tracks = [replace(t, rows=t.rows[::every], block=t.block[::every]) for t in view.tracks]
    return with_tracks(view, tracks)


def recorded_zoo_stage(law: str, kind: str, seed: int) -> tuple[tuple[Recording, ...], Lab, float]:
    """Return the recordings of a stage of the zoo, its declarations and its noise, rms in m."""
    offset = NAMES.index(law) * PER_LAW + list(KINDS).index(kind) * PER_KIND
    campaign = draw_stage(stage(law, kind, 0, seed - offset))
    return (*read_campaign(campaign), campaign.answer.noise_rms_m)


@cache
def healthy() -> tuple[tuple[Recording, ...], Lab]:
    return read_campaign(draw_campaign(20, truth="bouc_wen", plans=PLANS))


def view_of_recordings(recordings: Sequence[Recording], lab: Lab = NO_DECLARATIONS) -> View:
    return view_on(recordings, axis="x", lab=lab)


@cache
def healthy_view() -> View:
    return view_of_recordings(*healthy())
