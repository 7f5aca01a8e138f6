"""Signals while a motor may turn: they end a run as Ctrl-C does, and none of them breaks into a stop or half a message."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from contextlib import AbstractContextManager

from analyzer.cli.signals import handled


def as_interrupt() -> AbstractContextManager[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does."""
    return handled(signal.default_int_handler)


def undisturbed() -> AbstractContextManager[None]:
    """Let no signal break in."""
    return handled(signal.SIG_IGN)


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """Let signals wait until what is under way is done."""
    waiting: list[int] = []
    try:
        with handled(lambda number, frame: waiting.append(number)):
            yield
    finally:
        if waiting:
            signal.raise_signal(waiting[-1])
