"""Campaigns of the laboratory that several tests share."""

from functools import lru_cache

from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.effects import EFFECTS
from piezoid_datasets.virtual_lab.stage import Rows

EVERYTHING = ("sweep", "check", "rates", "staircase", "chirp", "other_axis", "long_hold")
SHOWN_BY = {
    effect.name: tuple(plan for plan in EVERYTHING if plan in effect.shown_by)
    for effect in EFFECTS
}


@lru_cache(maxsize=4)
def campaign(
    seed: int,
    name: str | None = None,
    size: float | None = None,
    plans: tuple[str, ...] | None = None,
) -> Campaign:
    """Draw a campaign, by default of the recordings that show the effect."""
    sizes = {} if name is None else {name: size}
    if plans is None:
        plans = EVERYTHING if name is None else SHOWN_BY[name]
    return draw_campaign(seed, effects=sizes, truth="preisach", plans=plans)


def pairs(
    seed: int, name: str, size: float | None = None, plans: tuple[str, ...] | None = None
) -> list[tuple[Rows, Rows]]:
    """Return each recording with and without the effect."""
    faulty = campaign(seed, name, size, plans)
    sound = campaign(seed, plans=plans or SHOWN_BY[name])
    return list(zip(faulty.recordings, sound.recordings, strict=True))


def pair(recording: str, seed: int, name: str, size: float | None = None) -> tuple[Rows, Rows]:
    plans = None if recording in SHOWN_BY[name] else (*SHOWN_BY[name], recording)
    recordings = pairs(seed, name, size, plans)
    return next(rows for rows in recordings if rows[0].run.name == recording)


def number(seed: int, name: str, key: str, size: float | None = None) -> float:
    return float(campaign(seed, name, size).answer.effects[0].numbers[key])
