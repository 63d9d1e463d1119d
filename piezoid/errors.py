"""All exceptions of piezoid.

    PiezoidError
    +-- RecordingError            the data cannot carry the question
    |   +-- UnreadableFileError       file, line, column
    |   +-- UnitError                 a column without a known unit or meaning
    |   +-- ExcitationError           too few reversals, too small a range or band
    +-- LabFileError              lab.toml says something we cannot use
    +-- IdentificationError       the fit has no usable answer
    |   +-- InfeasibleFitError        the constraints contradict each other
    |   +-- NotInvertibleError        weights leave the invertible region
    +-- DesignError               no controller meets the specification
    |   +-- UnstableLoopError
    |   +-- TemplateError             which template, at which frequency, by how much
    +-- ParameterFileError        wrong schema, failed digest, unknown name
    +-- OutputFolderError         a folder that may not be written
    +-- PictureError              nothing of that kind can be drawn
    +-- RuntimeLibraryError       compiled library missing or of another layout

A verdict is data; an error is an exception. Every message has three parts: what was found, what
was needed, what to do next. Wrong types from programmers raise Python's own errors.
"""

_LONGEST = 2000


def _said(part: str) -> str:
    """Escape a part of a message: names in it may come from any file.

    A megabyte of heading is cut; what would move a cursor, turn the text or break its encoding is
    shown as a code.
    """
    part = part if len(part) <= _LONGEST else f"{part[:_LONGEST]} ..."
    return "".join(
        c if c.isprintable() or c in "\n\xa0\u202f" else c.encode("unicode_escape").decode("ascii")
        for c in part
    )


class PiezoidError(Exception):
    """Base of all errors: problem, need and remedy.

    found    str  what was found, with its number, unit and place; a sentence without its stop
    needed   str  what was needed instead: a thing, named, never a clause
    remedy   str  what to do next, a whole sentence
    numbers  the values behind the message, for whoever catches it
    """

    exit_status = 3

    def __init__(self, found: str, *, needed: str, remedy: str, **numbers: object) -> None:
        self.found, self.needed, self.remedy = map(_said, (found, needed, remedy))
        # Two sentences and a label: what is needed may be a thing, several, or a range.
        super().__init__(f"{self.found}. Needed: {self.needed}. {self.remedy}")
        self.numbers = numbers

    def __reduce__(self) -> tuple[object, ...]:
        # An error comes back from another process as it was said there, word for word.
        return _said_again, (type(self), str(self)), self.__dict__


def _said_again(kind: type[PiezoidError], message: str) -> PiezoidError:
    return kind.__new__(kind, message)


class RecordingError(PiezoidError):
    """The data cannot carry the question."""


class UnreadableFileError(RecordingError):
    """A file is missing, damaged or of no known format."""


class UnitError(RecordingError):
    """The unit, axis or meaning of a column is ambiguous."""


class ExcitationError(RecordingError):
    """The recording does not excite the quantity to be identified."""


class LabFileError(PiezoidError):
    """lab.toml contains an unusable declaration."""


class IdentificationError(PiezoidError):
    """The fit has no usable answer."""

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
    """A file of ours is of another schema, changed, or incomplete."""


class OutputFolderError(PiezoidError):
    """A folder or file may not be overwritten: piezoid did not write it."""

    exit_status = 2


class PictureError(PiezoidError):
    """The requested kind of picture does not exist for a record."""


class RuntimeLibraryError(PiezoidError):
    """The compiled library is missing or of another layout."""
