"""Ends from outside, for those who have set something in motion: whatever asks for the end, the motor is stopped first.

Signals that end a process raise KeyboardInterrupt, as Ctrl-C does; while a stop is under way none of them breaks into it.
"""

from __future__ import annotations

import signal
from contextlib import AbstractContextManager

from analyzer.cli.signals import handled


def as_interrupt() -> AbstractContextManager[None]:
    """Let SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does."""
    return handled(signal.default_int_handler)


def undisturbed() -> AbstractContextManager[None]:
    """Let no signal break in."""
    return handled(signal.SIG_IGN)
