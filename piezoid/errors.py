"""All exceptions of piezoid.

    PiezoidError
    +-- RecordingError            the recordings are unsuitable
    |   +-- UnreadableFileError       file, line, column
    |   +-- UnitError                 a column without a known unit or meaning
    |   +-- ExcitationError           too few reversals, too small a range or band
    +-- LabFileError              lab.toml contains an unusable declaration
    +-- IdentificationError       the fit has no usable solution
    |   +-- InfeasibleFitError        the constraints contradict each other
    |   +-- NotInvertibleError        the weights have no inverse
    +-- DesignError               no controller meets the specification
    |   +-- UnstableLoopError
    |   +-- TemplateError             which template, at which frequency, by how much
    +-- ParameterFileError        wrong schema, wrong digest, unknown name
    +-- OutputFolderError         a folder that may not be written
    +-- PictureError              a plot that does not exist
    +-- RuntimeLibraryError       compiled library missing or of another layout

A failed verdict is a result and not an exception. Every message has three parts: what was found,
what is needed, and what to do next. Arguments of a wrong type raise Python's own exceptions.
"""

from unicodedata import category

_MAX_LENGTH = 2000  # characters; the heading of a damaged file can have a megabyte


def printable(text: str, keep: str = "") -> str:
    """Escape control characters, surrogates, and marks that reverse the direction of text.

    Names may come from any file: such characters move a cursor, reorder a line or break an
    encoding. ``keep`` names characters that stay.

    >>> printable("a\x1b[2J\u202eb")
    'a\\x1b[2J\\u202eb'
    """
    if text.isprintable():
        return text
    return "".join(
        c
        if c.isprintable() or category(c) == "Zs" or c in keep
        else c.encode("unicode_escape").decode("ascii")
        for c in text
    )


def _escape(part: str) -> str:
    """Truncate a part of a message, and escape its unprintable characters."""
    part = part if len(part) <= _MAX_LENGTH else f"{part[:_MAX_LENGTH]} ..."
    return printable(part, keep="\n")


class PiezoidError(Exception):
    """Base of all errors: problem, need and remedy.

    found    str  the problem with number, unit and location; a sentence without full stop
    needed   str  the requirement, as a noun phrase
    remedy   str  what to do next, a complete sentence
    numbers  the values in the message, for the caller
    """

    exit_status = 3

    def __init__(self, found: str, *, needed: str, remedy: str, **numbers: object) -> None:
        self.found, self.needed, self.remedy = map(_escape, (found, needed, remedy))
        super().__init__(f"{self.found}. Needed: {self.needed}. {self.remedy}")
        self.numbers = numbers

    def __reduce__(self) -> tuple[object, ...]:
        # Pickle the complete message, which __init__ would compose from its parts.
        return _rebuild, (type(self), str(self)), self.__dict__


def _rebuild(kind: type[PiezoidError], message: str) -> PiezoidError:
    return kind.__new__(kind, message)


class RecordingError(PiezoidError):
    """The recordings are unsuitable for the requested result."""


class UnreadableFileError(RecordingError):
    """A file is missing, damaged or of an unknown format."""


class UnitError(RecordingError):
    """The unit, axis or meaning of a column is ambiguous."""


class ExcitationError(RecordingError):
    """The recording does not excite the quantity to be identified."""


class LabFileError(PiezoidError):
    """lab.toml contains an unusable declaration."""


class IdentificationError(PiezoidError):
    """The fit has no usable solution."""

    exit_status = 4


class InfeasibleFitError(IdentificationError):
    """The constraints of a fit contradict each other."""


class NotInvertibleError(IdentificationError):
    """The weights have no inverse."""


class DesignError(PiezoidError):
    """No controller meets the specification."""

    exit_status = 4


class UnstableLoopError(DesignError):
    """A closed loop has a pole on or outside the unit circle."""


class TemplateError(DesignError):
    """A sensitivity function violates its template."""


class ParameterFileError(PiezoidError):
    """A sealed file has another schema, was changed, or is incomplete."""


class OutputFolderError(PiezoidError):
    """A folder or file may not be overwritten: piezoid did not write it."""

    exit_status = 2


class PictureError(PiezoidError):
    """The requested plot does not exist for a record."""


class RuntimeLibraryError(PiezoidError):
    """The compiled library is missing or has another layout."""
