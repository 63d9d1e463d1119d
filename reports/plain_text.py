"""Names from files as text: characters that a browser does not show or executes become codes.

Escaping keeps ``<`` from being markup. Control characters, halves of pairs and marks that turn the
direction of the text are no markup, yet break a page or make it lie; they become ``\\u202e``.
"""

import unicodedata

_SHOWN_AS_CODE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
_OURS = {"\u202f"}


def printable(value: object) -> object:
    """Return a text with codes for its unprintable characters; other values unchanged."""
    if not isinstance(value, str) or hasattr(value, "__html__") or value.isprintable():
        return value
    return "".join(
        c
        if c in _OURS or unicodedata.category(c) not in _SHOWN_AS_CODE
        else c.encode("unicode_escape").decode("ascii")
        for c in value
    )
