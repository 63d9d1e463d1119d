"""Other people's text, made harmless before it is written into a comment of a program."""

import re

_HARMLESS = re.compile(r"[^A-Za-z0-9 .,:;()+=_-]")


def inert(text: str, *, length: int = 80) -> str:
    """Return ``text`` as plain ASCII that ends no comment, line or string, and starts nothing.

    Whatever is not a letter, digit, space or plain punctuation becomes ``_``: a star and slash,
    a backslash, a line end, a quotation mark, a trigraph's question marks.
    """
    return _HARMLESS.sub("_", text)[:length]
