"""Values that a frozen record makes of itself when they are first asked for, and then keeps."""

from collections.abc import Callable
from typing import Any, Generic, Self, TypeVar, overload

Value = TypeVar("Value", covariant=True)


class Once(Generic[Value]):
    """What ``functools.cached_property`` is from Python 3.12 on: no record waits for another.

    Before, one lock for all records of a class let only one thread make anything. Two threads that
    ask at once may both make the value; both are given the one that was there first.
    """

    def __init__(self, make: Callable[[Any], Value]) -> None:
        """Take the method that makes the value."""
        self._make = make
        self.__doc__ = make.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        """Learn under which name the value is kept."""
        self._name = name

    @overload
    def __get__(self, instance: None, owner: type | None = None) -> Self: ...
    @overload
    def __get__(self, instance: object, owner: type | None = None) -> Value: ...
    def __get__(self, instance: object | None, owner: type | None = None) -> Self | Value:
        """Make the value; once it is kept, nobody comes here."""
        if instance is None:
            return self
        kept: Value = vars(instance).setdefault(self._name, self._make(instance))
        return kept
