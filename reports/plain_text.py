"""Names from files, made harmless: what a browser cannot show, or would obey, is shown as a code.

Escaping keeps ``<`` from being markup. Control characters, halves of pairs and marks that turn the
direction of the text are no markup, yet break a page or make it lie; they become ``\\u202e``.
"""

import unicodedata

_SHOWN_AS_CODE = {"Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"}
_OURS = {"\u202f"}


def printable(value: object) -> object:
    """Return a text with its unprintable characters as codes; anything else as it is."""
    if not isinstance(value, str) or hasattr(value, "__html__") or value.isprintable():
        return value
    return "".join(_shown(character) for character in value)


def _shown(character: str) -> str:
    if character in _OURS or unicodedata.category(character) not in _SHOWN_AS_CODE:
        return character
    return character.encode("unicode_escape").decode("ascii")
