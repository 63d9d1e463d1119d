"""Read TOML files of users, and write strings for them.

Text for which the parser would need minutes is rejected.
"""

import json
import tomllib
from typing import Any

# The time of the parser grows with the square of the number of parts of a key.
_MAX_WORK = 4_000_000


def toml_string(text: str) -> str:
    """Return a text as a TOML string with its quotes.

    A JSON string is a TOML string if it has no surrogate escapes and no delete character.
    """
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def read_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises ``ValueError``, with the line or the reason, for text that is not TOML, keys with
    thousands of parts, deeply nested lists, and very long numbers.
    """
    work = 0
    for number, line in enumerate(text.split("\n"), start=1):
        work += line.count(".") ** 2
        if work > _MAX_WORK:
            raise ValueError(f"line {number} contains {line.count('.')} dots")
    try:
        return tomllib.loads(text)
    except RecursionError as error:
        raise ValueError("its lists and tables are nested too deep") from error
