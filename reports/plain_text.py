"""Replace unprintable characters in names from files by escape codes.

HTML escaping handles ``<``, but not control characters, surrogates, or marks that reverse the
direction of text. These become codes such as ``\\u202e``.
"""

import unicodedata

_UNPRINTABLE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}  # Unicode categories


def printable(value: object) -> object:
    """Replace the unprintable characters of a text by codes; return other values unchanged."""
    if not isinstance(value, str) or hasattr(value, "__html__") or value.isprintable():
        return value
    return "".join(
        c.encode("unicode_escape").decode("ascii")
        if unicodedata.category(c) in _UNPRINTABLE
        else c
        for c in value
    )
