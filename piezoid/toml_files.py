"""Read TOML written by people; text that would take the parser minutes is rejected."""

import tomllib
from typing import Any

# The parser takes time with the square of a key's parts; a line of a thousand numbers is nothing.
_MOST_WORK = 4_000_000


def read_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises ``ValueError``, with the line or the reason, for a text that is no TOML or that no
    person would write: keys of thousands of parts, lists nested without end, endless numbers.
    """
    work = 0
    for number, line in enumerate(text.split("\n"), start=1):
        work += line.count(".") ** 2
        if work > _MOST_WORK:
            raise ValueError(f"line {number} holds {line.count('.')} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("its lists and tables are nested too deep") from error
