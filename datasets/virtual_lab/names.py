"""Finding a member of a registry by name, or saying which names there are."""

from collections.abc import Sequence
from typing import Protocol, TypeVar


class _Named(Protocol):
    @property
    def name(self) -> str:
        """What it is called."""


Member = TypeVar("Member", bound=_Named)


def named(known: Sequence[Member], name: str) -> Member:
    """Return the member of that name; raise ``ValueError`` listing all names if there is none."""
    for member in known:
        if member.name == name:
            return member
    names = ", ".join(sorted(member.name for member in known))
    raise ValueError(f"{name!r} is not known here; known are {names}")
