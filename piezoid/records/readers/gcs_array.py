"""PI general command set arrays: ``# KEY = value`` lines, ``# END_HEADER``, then columns.

What data recorders of Physik Instrumente controllers write. The separator is given by its
character code, the clock by ``SAMPLE_TIME`` in seconds, the columns by ``NAME0``, ``NAME1``, ...
"""

import re

from piezoid.records.readers.reader import Reader
from piezoid.records.readers.source import Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, count_of, number_of, parse_numbers
from piezoid.records.table import Column, RawTable, rate_of

_KEY = re.compile(r"\s*#\s*([A-Z_]+\d*)\s*")


def recognises(source: Source) -> bool:
    """Tell it by its end mark or its keys among the first bytes."""
    return re.search(rb"^[ \t]*#[ \t]*END_HEADER[ \t\r]*$", source.head, re.MULTILINE) is not None


def read(source: Source) -> RawTable:
    """Read the array; the file states no units, so they must come from names or lab.toml."""
    lines = text_of(source).rstrip().split("\n")
    end = next(k for k, line in enumerate(lines) if re.fullmatch(r"\s*#\s*END_HEADER\s*", line))
    pairs = _pairs(lines[:end])
    fields = count_of(pairs.get("DIM", "")) or 0
    code = count_of(pairs.get("SEPARATOR", ""))
    code = 32 if code is None else code
    body = "\n".join(line.strip() for line in lines[end + 1 :])
    if not 0 < fields < 1000 or code not in (9, 32, 44, 59) or not body.strip():
        raise unreadable(
            source.name,
            f"DIM is {pairs.get('DIM')}, SEPARATOR is {pairs.get('SEPARATOR')}, "
            f"{len(lines) - end - 1} rows follow line {end + 1}",
            needed="a count of columns, a separator (tab, blank, comma, semicolon) and rows",
            remedy="Write the array again from the controller's software.",
            line=end + 1,
        )
    layout = Layout(separator="" if code == 32 else chr(code), decimal=".", fields=fields)
    block = parse_numbers(body, layout, source.name, end + 2)
    interval_s = number_of(pairs.get("SAMPLE_TIME", ""), ".")
    return RawTable(
        name=source.name,
        digest=source.digest,
        format="PI GCS array",
        columns=tuple(
            Column(number=k + 1, label=pairs.get(f"NAME{k}", ""), values=values)
            for k, values in enumerate(block.columns)
        ),
        sampling_rate_Hz=rate_of(interval_s),
        first_line=end + 2,
        metadata=pairs,
        statements=block.statements,
    )


def _pairs(lines: list[str]) -> dict[str, str]:
    found = {}
    for line in lines:
        key, parted, value = line.partition("=")
        named = _KEY.fullmatch(key)
        if parted and named:
            found[named.group(1)] = value.strip()
    return found


READER = Reader(name="PI GCS array", suffixes=(".dat", ".txt"), recognises=recognises, read=read)
