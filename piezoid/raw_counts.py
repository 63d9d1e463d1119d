"""Results in counts of a converter, for recordings without a calibration in metres or volts.

The library treats one count as one metre or one volt. The field ``counted`` of recordings, models
and diagnoses names the quantities in counts. Texts are converted when they leave the library:
``6.06 km`` becomes ``6.06 kcounts``.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

from piezoid.errors import LabFileError, PiezoidError

COUNTS = "counts"
# Quantities that may be in counts, with the SI symbol and word that stand for counts in texts.
DISPLACEMENT, VOLTAGE = "displacement", "voltage"
SYMBOLS = {DISPLACEMENT: "m", VOLTAGE: "V"}
WORDS = {DISPLACEMENT: r"met(?:re|er)(s?)", VOLTAGE: r"volt(s?)"}
TERM = r"[pnuµmkMG]?(?:m|V)"
# A symbol without prefix is a unit only after a number, in brackets or as the complete text.
UNIT = re.compile(rf"(?<![\w./-])(?:1/({TERM})|({TERM})(/(?:s|√Hz|Hz|{TERM}))?)(?![\w(])")
NUMBER_BEFORE = re.compile(r"(?:\d|\d\)|\bper)[ \u202f\xa0]$")
# Fields of a model or a diagnosis with sentences; other fields contain names and numbers.
TEXT_FIELDS = (
    *("verdict", "quality", "dynamics_remarks"),
    *("findings", "not_detected", "budget", "unexplained"),
)
Record = TypeVar("Record")


def in_counts(text: str, counted: Collection[str]) -> str:
    """Replace metres, volts or both in a text by counts.

    counted  subset of ``displacement`` and ``voltage``

    >>> in_counts("33.2 km, noise 9.5 m; 12 µm/V", ("displacement",))
    '33.2 kcounts, noise 9.5 counts; 12 µcounts/V'
    """
    if not counted:
        return text
    symbols = {SYMBOLS[quantity] for quantity in counted}

    def term(symbol: str) -> str:
        return symbol[:-1] + COUNTS if symbol[-1] in symbols else symbol

    def unit(match: re.Match[str]) -> str:
        denominator, numerator, per = match.groups()
        if denominator:
            return "1/" + term(denominator)
        preceding, following = match.string[: match.start()], match.string[match.end() :]
        if len(numerator) == 1 and not per and not NUMBER_BEFORE.search(preceding):
            neighbours = preceding[-1:], following[:1]
            if neighbours not in (("", ""), ("[", "]"), ("(", ")"), ("", ",")):
                return match.group()
        if per and per[1:] not in ("s", "√Hz", "Hz"):
            per = "/" + term(per[1:]).replace(COUNTS, "count")
        return term(numerator) + (per or "")

    text = UNIT.sub(unit, text)
    for quantity in counted:
        text = re.sub(rf"\b{WORDS[quantity]}\b", r"count\1", text)
    return text


def record_in_counts(record: Any, counted: Collection[str]) -> Any:
    """Return a record, tuple or mapping with counts in all of its texts.

    A size in nanometres (``value``, ``unit`` and ``ci95``) is converted to counts without prefix,
    because a billionth of a count has no meaning.
    """
    if not counted:
        return record
    if isinstance(record, str):
        return in_counts(record, counted)
    if isinstance(record, tuple):
        return tuple(record_in_counts(item, counted) for item in record)
    if isinstance(record, Mapping):
        return {name: record_in_counts(value, counted) for name, value in record.items()}
    if not is_dataclass(record) or isinstance(record, type):
        return record
    old = {field.name: getattr(record, field.name) for field in fields(record)}
    if DISPLACEMENT in counted and "ci95" in old and old["unit"].startswith("nm"):
        low, high = old["ci95"]
        record = replace(
            record,
            value=1e-9 * old["value"],
            unit=old["unit"][1:],
            ci95=(1e-9 * low, 1e-9 * high),
        )
        old = {field.name: getattr(record, field.name) for field in fields(record)}
    new = {name: record_in_counts(value, counted) for name, value in old.items()}
    return replace(record, **{n: value for n, value in new.items() if value is not old[n]})


def texts_in_counts(labelled: Record) -> Record:
    """Return the model of an axis, or a diagnosis, with counts in its sentences.

    >>> texts_in_counts(model["x"]) is model["x"]
    True
    """
    record: Any = labelled
    if not record.counted:
        return labelled
    names = [field.name for field in fields(record) if field.name in TEXT_FIELDS]
    texts = {name: record_in_counts(getattr(record, name), record.counted) for name in names}
    return replace(record, **texts)  # type: ignore[no-any-return]


def refuse_counts(
    axis: str, counted: Collection[str], *, quantities: Collection[str] = (DISPLACEMENT, VOLTAGE)
) -> None:
    """Raise ``LabFileError`` if a quantity that must be in SI units is in counts.

    axis        name of the axis
    counted     quantities in counts
    quantities  quantities that must be in SI units

    >>> refuse_counts("x", counted=())
    """
    for quantity in (name for name in quantities if name in counted):
        raise LabFileError(
            f"axis {axis}: its {quantity} is recorded in counts of the converter",
            needed=f"the size of one count in {SYMBOLS[quantity]}; no drive or controller can be "
            "written in counts",
            remedy="Add to the [[recording]] of each file in lab.toml, and fit again:\n\n"
            f"scale = {{ {quantity} = ... }}\n",
        )


@contextmanager
def errors_in_counts(counted: Collection[str]) -> Iterator[None]:
    """Convert the messages of piezoid errors in the block to counts."""
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
