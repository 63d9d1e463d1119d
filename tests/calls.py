"""How often Python enters a function while something is done; nothing is put in its place."""

import sys
from collections.abc import Callable
from inspect import unwrap
from types import FrameType


def calls_of(function: Callable[..., object], act: Callable[[], object]) -> int:
    """Return how often ``act`` entered a function written in Python, in this thread."""
    code, entered = unwrap(function).__code__, 0

    def seen(frame: FrameType, event: str, _: object) -> None:
        nonlocal entered
        entered += event == "call" and frame.f_code is code

    before = sys.getprofile()
    sys.setprofile(seen)
    try:
        act()
    finally:
        sys.setprofile(before)
    return entered
