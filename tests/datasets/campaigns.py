"""Campaigns of the laboratory that several tests share."""

from functools import lru_cache

from piezoid_datasets.virtual_lab.campaign import Campaign, draw_campaign
from piezoid_datasets.virtual_lab.stage import Rows

EVERYTHING = ("sweep", "check", "rates", "staircase", "chirp", "other_axis", "long_hold")


@lru_cache(maxsize=4)
def campaign(seed: int, name: str | None = None, size: float | None = None) -> Campaign:
    sizes = {} if name is None else {name: size}
    return draw_campaign(seed, effects=sizes, truth="preisach", plans=EVERYTHING)


def pairs(seed: int, name: str, size: float | None = None) -> list[tuple[Rows, Rows]]:
    faulty, sound = campaign(seed, name, size), campaign(seed)
    return list(zip(faulty.recordings, sound.recordings, strict=True))


def pair(recording: str, seed: int, name: str, size: float | None = None) -> tuple[Rows, Rows]:
    return next(rows for rows in pairs(seed, name, size) if rows[0].run.name == recording)


def number(seed: int, name: str, key: str, size: float | None = None) -> float:
    return float(campaign(seed, name, size).answer.effects[0].numbers[key])
