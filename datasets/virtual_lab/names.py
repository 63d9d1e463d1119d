"""Look up a member of a registry by name."""

from collections.abc import Sequence
from typing import Protocol, TypeVar


class _Named(Protocol):
    @property
    def name(self) -> str:
        """Name of the member."""


Member = TypeVar("Member", bound=_Named)


def named(known: Sequence[Member], name: str) -> Member:
    """Return the member with a name; raise ``ValueError`` with all names if it does not exist."""
    for member in known:
        if member.name == name:
            return member
    names = ", ".join(sorted(member.name for member in known))
    raise ValueError(f"{name!r} is not known here; known are {names}")
