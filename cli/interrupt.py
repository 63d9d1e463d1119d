"""Ctrl-C: exit status 130 and one line, from the first import to the last file.

This module is imported before all others of the command line, and imports little itself. While
modules load, no work is unfinished, and the process ends at once. Later, ``Interrupted`` is
raised, so that unfinished files and workers are removed. It is raised repeatedly in case a library
suppresses it.
"""

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

INTERRUPTED = 130  # exit status of a program that Ctrl-C ended, by convention of shells
_LINE = "interrupted: no file is left half written\n"
_REPEAT_s = 0.05


class Interrupted(BaseException):
    """Raised when the user presses Ctrl-C."""


class _State:
    """State of the signal handler of this process."""

    is_loading = True  # no work needs to be undone
    is_interrupted = False
    is_postponed = False


def install() -> None:
    """Install the handler of Ctrl-C; worker processes ignore the signal."""
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

    After Ctrl-C, any exception counts as the interruption, because libraries may convert it.
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
    """Raise ``Interrupted`` only at the end of a block that must be completed."""
    outer, _State.is_postponed = _State.is_postponed, True
    try:
        yield
    finally:
        _State.is_postponed = outer
        if _State.is_interrupted and not outer and not _is_propagating():
            raise Interrupted


def _handle(number: int, _: object) -> None:
    if number == signal.SIGINT:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # ignore a second press during the cleanup
        if _State.is_loading:
            os.write(2, _LINE.encode())
            os._exit(INTERRUPTED)
        _State.is_interrupted = True
        if hasattr(signal, "setitimer"):
            signal.signal(signal.SIGALRM, _handle)
            signal.setitimer(signal.ITIMER_REAL, _REPEAT_s, _REPEAT_s)
    if not _State.is_postponed and not _is_propagating():
        raise Interrupted


def _is_propagating() -> bool:
    """Return whether ``Interrupted`` is already propagating through blocks that clean up."""
    error = sys.exc_info()[1]
    while error is not None and not isinstance(error, Interrupted):
        error = error.__context__
    return error is not None


def _stop_raising() -> None:
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    _State.is_postponed = True
    if signal.getsignal(signal.SIGINT) is _handle:  # at exit Python removes Python handlers
        signal.signal(signal.SIGINT, signal.SIG_IGN)
