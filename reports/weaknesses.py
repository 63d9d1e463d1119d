"""What holds an axis back most, and the recording or repair that would help."""

from collections.abc import Callable
from dataclasses import dataclass

from piezoid.diagnosis.diagnosis import Diagnosis
from piezoid.formatting import words
from piezoid.identification.model import AxisModel
from piezoid.identification.piece_start import wandering_zeros
from piezoid.identification.quality import OTHER_RECORDINGS
from piezoid_reports.quantities import percent, told
from piezoid_reports.what_is_left import left_of, mover_of

NEAR_NOISE = 1.2  # what is left beside the noise is two thirds of it, and hides there
FAR_FROM_NOISE = 4.0  # graver than that no other drive was recorded: the model misses much
LOOSE = 0.2  # of the loop's width: an interval wider than that leaves the width open
FEW_BLOCKS = 10


# what was never measured or is odd about what was, in a few words, and the recording that helps
REMEDY = {
    "branch": (
        "that only one branch was recorded",
        "Record whole cycles of the drive, up and down, several times.",
    ),
    "loop": (
        "that only one loop was recorded",
        "Record at least two cycles, and some of smaller size.",
    ),
    "speed": (
        "that the rate was never varied",
        "Repeat the same drive ten times slower: a loop that stays as wide is hysteresis, one "
        "that shrinks is lag.",
    ),
    "amplitude": (
        "that every branch has one amplitude",
        "Record reversals of decreasing size over the whole range.",
    ),
    "closed_loop": (
        "that a feedback seems to hold the sensor",
        "Open the loop and record again, the drive free.",
    ),
    "leads": (
        "that the displacement turns before its drive",
        "Check which column is which, and that one clock stamps both.",
    ),
    "smoothed": (
        "that the readings were smoothed afterwards",
        "Read the file as it was recorded: noise, delay and modes are in what smoothing took.",
    ),
    "implausible_gain": (
        "a gain that hardly any stage has",
        "Check both units, and whether the drive is a monitor's output.",
    ),
    "stands": (
        "that the displacement stands while the drive goes on",
        "Record with the drive inside that end, or leave those cycles out.",
    ),
    "slides": (
        "that the displacement slides against its drive",
        "Stamp both channels by one clock, and record again.",
    ),
    "zero_jump": (
        "a zero that jumps",
        "Tighten the mount, look after the sensor's zero and its counter, and record again.",
    ),
}


@dataclass(frozen=True, kw_only=True)
class Weakness:
    """One thing that weakens a fit.

    what    a few words, to follow "what weakens it most is"
    why     one sentence with its number
    remedy  the next experiment or repair
    """

    what: str
    why: str
    remedy: str


@dataclass(frozen=True, kw_only=True)
class Judged:
    """What is known of an axis: its model, and what a diagnosis of the same data says, if any."""

    axis: AxisModel
    diagnosis: Diagnosis | None = None


Rule = Callable[[Judged], Weakness | None]


def weaknesses_of(axis: AxisModel, diagnosis: Diagnosis | None = None) -> tuple[Weakness, ...]:
    """Return everything that weakens the fit of an axis, the gravest first.

    diagnosis  of that axis: where it names a cause, cause and experiment are the diagnosis' own
    """
    judged = Judged(axis=axis, diagnosis=diagnosis)
    return tuple(found for rule in RULES if (found := rule(judged)) is not None)


def _class_does_not_apply(judged: Judged) -> Weakness | None:
    verdict = judged.axis.verdict
    if verdict.applies:
        return None
    return Weakness(
        what="that the model class does not apply",
        why=f"The model class does not apply: {verdict.reason}.",
        remedy="Check which column is which and that both channels are sampled at the same "
        "instant, then sweep ten times slower; if the reason stays, another model is needed.",
    )


def _never_measured(judged: Judged) -> Weakness | None:
    """Tell the gravest lack of the data; one recording, or one amplitude, has a later rule."""
    for limit in judged.axis.quality.limits:
        if limit.lack in REMEDY:
            what, remedy = REMEDY[limit.lack]
            return Weakness(
                what=what,
                why=f"{limit.reason[:1].upper()}{limit.reason[1:]}.",
                remedy=remedy,
            )
    return None


def _one_excitation(judged: Judged) -> Weakness | None:
    recordings = {start.recording for start in judged.axis.starts}
    if judged.axis.quality.held_out_kind == OTHER_RECORDINGS or len(recordings) > 1:
        return None
    return Weakness(
        what="that it was tested on parts of its only recording",
        why="Only one recording was given, so the held-out error is from parts of it that were "
        "left out, and the drive it was tested on is of the same kind.",
        remedy="Record a second, different drive: reversals of many sizes at another speed.",
    )


def _not_converged(judged: Judged) -> Weakness | None:
    if judged.axis.quality.converged:
        return None
    return Weakness(
        what="that the search stopped before it converged",
        why="The search stopped at its limit of iterations; a better fit may exist.",
        remedy="Record reversals of decreasing size over the whole range, which tell neighbouring "
        "plays apart, and fit again with both recordings.",
    )


def _wandering_zero(judged: Judged) -> Weakness | None:
    axis = judged.axis
    quality = axis.quality
    moved = wandering_zeros(axis.starts, quality.rms_m, quality.range_m)
    if not moved:
        return None
    by_m, where = max((by_m, start.recording) for start, by_m in moved)
    moves = f"The zero moves by {told(by_m, 'm')} ({percent(by_m / quality.range_m)} of the "
    moves += f"range) during {where}; the fit followed this"
    mover = mover_of(judged.diagnosis)
    if mover is not None:
        return Weakness(
            what=f"a zero that moves by {told(by_m, 'm')}, beside {mover.name}",
            why=f"{moves}, beside the {mover.name} that the diagnosis found.",
            remedy=mover.experiment,
        )
    return Weakness(
        what=f"a zero that moves by {told(by_m, 'm')}, by drift or creep",
        why=f"{moves}, and no held-out error did. It is {_times(by_m, quality.noise_rms_m)} "
        f"the sensor noise, and drift and creep are not separable in it{_bounds(judged)}.",
        remedy="Step to mid-range and hold the drive constant for ten minutes after warming up: "
        "creep slows down as it goes, thermal drift does not.",
    )


def _bounds(judged: Judged) -> str:
    """Say how much of either there may be, where a diagnosis bounds it."""
    unseen = () if judged.diagnosis is None else judged.diagnosis.not_detected
    known = [
        f"{words(one.effect)} at {told(one.upper_bound_m, 'm')} rms"
        for one in unseen
        if one.effect in ("creep", "thermal_drift") and one.upper_bound_m is not None
    ]
    return f"; the diagnosis bounds {' and '.join(known)}" if known else ""


def _noise_is_not_told(judged: Judged) -> Weakness | None:
    quality = judged.axis.quality
    if not quality.noise_is_most:
        return None
    return Weakness(
        what="that the sensor's noise is not known",
        why="The drive moves the stage from sample to sample and never repeats: the noise told, "
        f"{told(quality.noise_rms_m, 'm')} rms, is what the model leaves, and the sensor's may be "
        "far smaller.",
        remedy="Play the drive twice: what differs between two equal periods is noise.",
    )


def _much_above_noise(judged: Judged) -> Weakness | None:
    """Tell of an error that is graver than that nothing else was recorded."""
    return _above_noise(judged) if _exceeds(FAR_FROM_NOISE, judged) else None


def _little_above_noise(judged: Judged) -> Weakness | None:
    is_little = _exceeds(NEAR_NOISE, judged) and not _exceeds(FAR_FROM_NOISE, judged)
    return _above_noise(judged) if is_little else None


def _exceeds(times: float, judged: Judged) -> bool:
    quality = judged.axis.quality
    return quality.held_out_rms_m > times * quality.noise_rms_m


def _above_noise(judged: Judged) -> Weakness:
    quality = judged.axis.quality
    far = f"{_times(quality.held_out_rms_m, quality.noise_rms_m)} the sensor noise"
    left = left_of(judged.diagnosis, judged.axis)
    return Weakness(
        what=f"an error {far}{left.short}",
        why=f"The held-out error is {far}{left.why}",
        remedy=left.remedy,
    )


def _few_blocks(judged: Judged) -> Weakness | None:
    blocks = judged.axis.uncertainty.blocks
    if blocks >= FEW_BLOCKS:
        return None
    return Weakness(
        what=f"that its intervals rest on {blocks} blocks of cycles",
        why=f"Every interval rests on {blocks} blocks of cycles.",
        remedy="Record at least twelve cycles, of different sizes.",
    )


def _loose_loop(judged: Judged) -> Weakness | None:
    width_m, half_m = judged.axis.uncertainty.loop_width_m
    if half_m <= LOOSE * abs(width_m):
        return None
    return Weakness(
        what=f"a loop width known to ± {told(half_m, 'm')} only",
        why=f"The loop's width is known to ± {told(half_m, 'm')} only, of {told(width_m, 'm')}.",
        remedy="Record full-range cycles in both directions, several times, at one speed.",
    )


def _sensor_limits(judged: Judged) -> Weakness | None:
    quality = judged.axis.quality
    if quality.noise_is_most or _exceeds(NEAR_NOISE, judged):
        return None
    return Weakness(
        what="the sensor, which sees no more",
        why=f"The held-out error is {_times(quality.held_out_rms_m, quality.noise_rms_m)} the "
        "sensor noise: this sensor sees no more.",
        remedy="Nothing is needed; a quieter sensor or averaging would show what is left.",
    )


def _times(value: float, reference: float) -> str:
    return f"{value / reference:.1f} times" if reference > 0.0 else "far above"


RULES: tuple[Rule, ...] = (
    _class_does_not_apply,
    _never_measured,
    _much_above_noise,
    _one_excitation,
    _few_blocks,
    _loose_loop,
    _noise_is_not_told,
    _little_above_noise,
    _wandering_zero,
    _not_converged,
    _sensor_limits,
)
