"""What a diagnosis looked for and did not find: how large it could be, beside the noise."""

from statistics import median

from piezoid.diagnosis.diagnosis import Diagnosis, NotDetected
from piezoid.diagnosis.effects import effect_named
from piezoid.readable import words
from piezoid_reports.page import Part, Table
from piezoid_reports.quantities import percent, significant, told


def tables(found: Diagnosis) -> tuple[Part, ...]:
    """Return causes and faults of the data that were not found, the least known first."""
    causes, faults = _causes(found), _faults(found)
    noise_m = found.noise_floor_rms_m
    parts: list[Part] = []
    if causes:
        parts.append(
            Table(
                caption="What was looked for and not found, what hides best first. At most: what "
                "it could be (rms, 95 %). Would show from: the size found in four of five cases. "
                f"Beside the noise: the larger of both, in parts of {told(noise_m, 'm')} rms."
                f"{_placebos(causes)}",
                columns=("effect", "at most", "would show from", "beside the noise", "evidence"),
                rows=tuple(_row(one, noise_m) for one in causes),
                wordy=(4,),
            )
        )
    if faults:
        parts.append(
            Table(
                caption="Faults of the data that were looked for and not found: heights of single "
                "spikes and steps.",
                columns=("fault", "would show from", "found"),
                rows=tuple(
                    (words(one.effect), _length(one.detection_limit_m), _sign(one))
                    for one in faults
                ),
            )
        )
    return tuple(parts)


def last_sentences(found: Diagnosis) -> str:
    """Return what is explained, and how small anything else must be."""
    floor = f"he sensor's noise floor is {told(found.noise_floor_rms_m, 'm')} rms"
    explained = f"T{floor}"
    if found.findings:
        part = percent(found.explained_fraction)
        explained = f"Of the explainable error, {part} is explained; t{floor}"
    causes = _causes(found)
    known = [one for one in causes if one.detection_limit_m is not None]
    if not known:
        return f"{explained}."
    limits_m = [_hidden_m(one) for one in known]
    hidden = len(causes) - len(known)
    beyond = "" if not hidden else f" {hidden} more could not be tested with these recordings."
    return (
        f"{explained}; no other cause that was tested is larger than "
        f"{told(limits_m[0], 'm')} rms{_of_noise(limits_m[0], found.noise_floor_rms_m)} "
        f"({words(known[0].effect)} hides best; half of them would show from "
        f"{told(median(limits_m), 'm')}).{beyond}{_about_faults(found)}"
    )


def _about_faults(found: Diagnosis) -> str:
    tested = [one for one in _faults(found) if one.detection_limit_m is not None]
    if not tested:
        return ""
    said = ", ".join(
        f"{words(one.effect)} from {told(one.detection_limit_m or 0.0, 'm')}" for one in tested
    )
    return f" Of faults of the data, these would have shown: {said}."


def _causes(found: Diagnosis) -> list[NotDetected]:
    return _hidden_first([one for one in found.not_detected if not _is_fault(one)])


def _faults(found: Diagnosis) -> list[NotDetected]:
    return _hidden_first([one for one in found.not_detected if _is_fault(one)])


def _is_fault(one: NotDetected) -> bool:
    """Tell what is found in the samples themselves before anything is fitted.

    Such sizes are heights of spikes and steps, which no rms can be compared with.
    """
    return effect_named(one.effect).fault is not None


def _hidden_first(absent: list[NotDetected]) -> list[NotDetected]:
    """Order by what could be there unseen; what could not be tested comes last."""
    return sorted(absent, key=lambda one: -_hidden_m(one))


def _hidden_m(one: NotDetected) -> float:
    """Return the larger of bound and limit: below it nothing is known of an effect."""
    return max(one.detection_limit_m or 0.0, one.upper_bound_m or 0.0)


def _row(one: NotDetected, noise_m: float) -> tuple[str, ...]:
    tested = one.detection_limit_m is not None
    return (
        words(one.effect),
        _length(one.upper_bound_m),
        _length(one.detection_limit_m),
        _times(_hidden_m(one), noise_m) if tested else "",
        _besides(one),
    )


def _besides(one: NotDetected) -> str:
    """Return the reason without the size that stands beside it in the table already."""
    first, _, rest = one.reason.partition("; ")
    return rest if rest and first.startswith("at most ") else one.reason


def _sign(one: NotDetected) -> str:
    """Return what was found of a fault, without the size beside it."""
    return one.reason.partition("; ")[0]


def _placebos(causes: list[NotDetected]) -> str:
    if not any("its placebo" in one.reason for one in causes):
        return ""
    return (
        " A placebo has the same freedom and no physics (creep run backwards, hum between the "
        "grids): what it takes off, chance takes off."
    )


def _of_noise(size_m: float, noise_m: float) -> str:
    return f", {_times(size_m, noise_m)} the noise" if noise_m > 0.0 else ""


def _times(size_m: float, noise_m: float) -> str:
    return f"{significant(size_m / noise_m, 2)} times" if noise_m > 0.0 else ""


def _length(value_m: float | None) -> str:
    return "not testable" if value_m is None else told(value_m, "m")
