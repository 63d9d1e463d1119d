"""PI general command set arrays: ``# KEY = value`` lines, ``# END_HEADER``, then columns.

The format of data recorders of Physik Instrumente controllers. ``SEPARATOR`` is a character code,
``SAMPLE_TIME`` the sampling interval in seconds; ``NAME0``, ``NAME1``, ... are the headings.
"""

import re
from dataclasses import replace

from piezoid.records.readers.reader import Reader, Source, text_of, unreadable
from piezoid.records.readers.text_numbers import Layout, count_of, number_of
from piezoid.records.readers.text_table import table_under
from piezoid.records.table import RawTable, rate_of

_SEPARATORS = {9: "\t", 32: "", 44: ",", 59: ";"}  # by character code
_END = re.compile(r"^[ \t]*#[ \t]*END_HEADER[ \t\r]*$", re.MULTILINE)
_PAIR = re.compile(r"^[ \t]*#[ \t]*([A-Z_]+\d*)[ \t]*=(.*)$", re.MULTILINE)


def read(source: Source) -> RawTable:
    """Read the array; units come from the names or from lab.toml, since the file states none."""
    text = text_of(source).rstrip()
    end = _END.search(text)
    assert end is not None
    line = text.count("\n", 0, end.end()) + 2
    body = "\n".join(row.strip() for row in text[end.end() + 1 :].split("\n"))
    pairs = {key: value.strip() for key, value in _PAIR.findall(text[: end.start()])}
    fields = count_of(pairs.get("DIM", "")) or 0
    code = count_of(pairs.get("SEPARATOR", ""))
    separator = _SEPARATORS.get(32 if code is None else code)
    if not 0 < fields < 1000 or separator is None or not body.strip():
        raise unreadable(
            source.name,
            f"DIM is {pairs.get('DIM')}, SEPARATOR is {pairs.get('SEPARATOR')}, "
            f"{len(body.split())} numbers follow line {line - 1}",
            needed="a count of columns, a separator (tab, blank, comma, semicolon) and rows",
            remedy="Write the array again from the controller's software.",
            line=line - 1,
        )
    layout = Layout(separator=separator, decimal=".", fields=fields)
    headings = [(pairs.get(f"NAME{k}", ""), "") for k in range(fields)]
    return replace(
        table_under(source, headings, body, layout, line),
        sampling_rate_Hz=rate_of(number_of(pairs.get("SAMPLE_TIME", ""), ".")),
    )


READER = Reader(
    name="PI GCS array",
    usual_suffixes=(".dat", ".txt"),
    recognises=lambda source: bool(_END.search(source.head.decode("latin-1"))),
    read=read,
)
