"""Ctrl-C: exit status 130 and one line, from the first import to the last file.

This module is imported before all others of the command line, and loads nothing itself. While
modules load nothing is half done, and the process ends at once. Later, ``Interrupted`` is raised,
so that unfinished files and workers are removed. Where a library swallows it, it is raised again.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

INTERRUPTED = 130  # what shells say of a program that Ctrl-C ended
_LINE = "interrupted: nothing is left half written\n"
_AGAIN_s = 0.05


class Interrupted(BaseException):
    """The user pressed Ctrl-C: unfinished work is removed, and the command ends."""


class _State:
    """State of the signal handler of this process."""

    is_loading = True  # nothing has begun that needs to be undone
    is_interrupted = False
    is_postponed = False


def install() -> None:
    """Let Ctrl-C end this process from now on; a worker leaves that to its parent."""
    process = sys.modules.get("multiprocessing.process")
    if process is not None and process.parent_process() is not None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        return
    signal.signal(signal.SIGINT, _handle)
    report_error = sys.unraisablehook
    sys.unraisablehook = lambda e: None if e.exc_type is Interrupted else report_error(e)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise ``Interrupted`` in the block; end the process with status 130 if Ctrl-C was pressed.

    Whatever exception the interruption became in a library that was loading counts as such.
    """
    _State.is_loading = _State.is_interrupted = _State.is_postponed = False
    try:
        yield
    except BaseException:
        _stop_raising()
        if not _State.is_interrupted:
            raise
    _stop_raising()
    if _State.is_interrupted:
        sys.stderr.write(_LINE)
        sys.exit(INTERRUPTED)


@contextmanager
def postponed() -> Iterator[None]:
    """Raise ``Interrupted`` only at the end of a block that must not be left in the middle."""
    outer, _State.is_postponed = _State.is_postponed, True
    try:
        yield
    finally:
        _State.is_postponed = outer
        if _State.is_interrupted and not outer and not _in_flight():
            raise Interrupted


def _handle(number: int, _: object) -> None:
    if number == signal.SIGINT:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second press must not disturb the end
        if _State.is_loading:
            os.write(2, _LINE.encode())
            os._exit(INTERRUPTED)
        _State.is_interrupted = True
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, _handle)
            signal.setitimer(signal.ITIMER_REAL, _AGAIN_s, _AGAIN_s)
    if not _State.is_postponed and not _in_flight():
        raise Interrupted


def _in_flight() -> bool:
    """Return whether the interruption is on its way up already, through blocks that clean up."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, Interrupted):
        error = error.__context__
    return error is not None


def _stop_raising() -> None:
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    _State.is_postponed = True
    if signal.getsignal(signal.SIGINT) is _handle:  # Python drops the handler before it unloads
        signal.signal(signal.SIGINT, signal.SIG_IGN)
