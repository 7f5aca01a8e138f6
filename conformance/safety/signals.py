"""Ends from outside, for those who have set something in motion: whatever asks for the end, the motor is stopped first.

Signals that end a process raise KeyboardInterrupt, as Ctrl-C does; while a stop is under way none of them breaks into it.
"""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Iterator
from typing import Any

#: Not every system has all of them.
_SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextlib.contextmanager
def as_interrupt() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does."""
    with _handled(signal.default_int_handler):
        yield


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Let no signal break in."""
    with _handled(signal.SIG_IGN):
        yield


@contextlib.contextmanager
def _handled(handler: Any) -> Iterator[None]:
    before: dict[int, Any] = {}
    # Elsewhere than in the main thread signals cannot be taken over, and do not arrive.
    with contextlib.suppress(ValueError):
        for number in _SIGNALS:
            before[number] = signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
