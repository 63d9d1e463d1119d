"""Texts of a stage that is recorded in counts of its converters: no metre and no volt in them.

A sensor without calibration gives counts, and so may a drive. Such numbers go the way of metres
and volts, one count in place of one metre or one volt; sentences and labels are written with SI
symbols as everywhere, and these become counts here: ``6.06 km`` is ``6.06 kcounts``.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any

from piezoid.errors import PiezoidError

COUNTS = "counts"
# What may be in counts, and the SI symbol and word that stand for it in texts.
DISPLACEMENT, VOLTAGE = "displacement", "voltage"
_SYMBOLS = {DISPLACEMENT: "m", VOLTAGE: "V"}
_WORDS = {DISPLACEMENT: r"met(?:re|er)(s?)", VOLTAGE: r"volt(s?)"}
_PREFIXES = "pnuµmkMG"
_TERM = rf"[{_PREFIXES}]?(?:m|V)"
# Symbols alone are letters like others: they are units behind a number, in brackets, or as all of
# a text. With a prefix, or over another unit, they are nothing else.
_UNIT = re.compile(rf"(?<![\w./-])(?:1/({_TERM})|({_TERM})(/(?:s|√Hz|Hz|{_TERM}))?)(?![\w(])")
_BEHIND_A_NUMBER = re.compile(r"(?:\d|\d\)|\bper)[ \u202f\xa0]$")


def in_counts(text: str, counted: Collection[str]) -> str:
    """Return a text with counts in place of metres, volts or both.

    counted  of ``displacement`` and ``voltage``

    >>> in_counts("33.2 km, noise 9.5 m; 12 µm/V", ("displacement",))
    '33.2 kcounts, noise 9.5 counts; 12 µcounts/V'
    """
    if not counted:
        return text
    symbols = {_SYMBOLS[one] for one in counted}

    def term(symbol: str) -> str:
        return symbol[:-1] + COUNTS if symbol[-1] in symbols else symbol

    def unit(match: re.Match[str]) -> str:
        below, above, over = match.groups()
        if below:
            return "1/" + term(below)
        if len(above) == 1 and not over and not _is_unit(match):
            return match.group()
        if over and over[1:] not in ("s", "√Hz", "Hz"):
            over = "/" + term(over[1:]).replace(COUNTS, "count")
        return term(above) + (over or "")

    text = _UNIT.sub(unit, text)
    for one in counted:
        text = re.sub(rf"\b{_WORDS[one]}\b", r"count\1", text)
    return text


def _is_unit(match: re.Match[str]) -> bool:
    """Tell whether a symbol without prefix is the unit of something."""
    before, behind = match.string[: match.start()], match.string[match.end() :]
    if _BEHIND_A_NUMBER.search(before):
        return True
    return (before[-1:], behind[:1]) in (("", ""), ("[", "]"), ("(", ")"), ("", ","))


def record_in_counts(record: Any, counted: Collection[str]) -> Any:
    """Return a record, a tuple or a table with every text in it as ``in_counts`` has it."""
    if not counted:
        return record
    if isinstance(record, str):
        return in_counts(record, counted)
    if isinstance(record, tuple):
        return tuple(record_in_counts(one, counted) for one in record)
    if isinstance(record, Mapping):
        return {name: record_in_counts(one, counted) for name, one in record.items()}
    if is_dataclass(record) and not isinstance(record, type):
        held = {f.name: getattr(record, f.name) for f in fields(record)}
        told = {name: record_in_counts(one, counted) for name, one in held.items()}
        return replace(record, **{n: one for n, one in told.items() if one is not held[n]})
    return record


@contextmanager
def refusing_in_counts(counted: Collection[str]) -> Iterator[None]:
    """Let refusals say counts."""
    try:
        yield
    except PiezoidError as error:
        if not counted:
            raise
        raise type(error)(
            in_counts(error.found, counted),
            needed=in_counts(error.needed, counted),
            remedy=in_counts(error.remedy, counted),
            **error.numbers,
        ) from error
