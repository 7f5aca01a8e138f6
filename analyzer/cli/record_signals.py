"""Ctrl-C, SIGTERM and a closed terminal while recording: the first ends it in order, the next ones say how that goes."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

from analyzer.live.supervisor import Supervisor

_NAMES = {
    number: text
    for name, text in (("SIGINT", "Ctrl-C"), ("SIGTERM", "SIGTERM"), ("SIGHUP", "a terminal that closed (SIGHUP)"))
    if (number := getattr(signal, name, None)) is not None
}
#: A Ctrl-C this soon after the one before is the same impatience.
_AGAIN_S = 1.0


class Signals:
    """While this is entered, the signals that would end the program end the recording. In the main thread only.

    The second says that the log is being finished, a third Ctrl-C leaves that to `servotap recover`.
    """

    def __init__(self, supervisor: Supervisor, say: Callable[[str], None]) -> None:
        self._supervisor = supervisor
        self._say = say
        self._before: dict[int, Any] = {}
        self._told = 0.0

    def __enter__(self) -> Signals:
        """Take the signals over."""
        for number in _NAMES:
            self._before[number] = signal.signal(number, self._arrived)
        return self

    def __exit__(self, *exception: object) -> None:
        """Give the signals back."""
        for number, before in self._before.items():
            signal.signal(number, before)

    def _arrived(self, number: int, frame: FrameType | None) -> None:
        if not self._supervisor.reason:
            self._supervisor.stop(_NAMES[number])
        elif not self._told:
            self._told = time.monotonic()
            self._say("the log is being finished; Ctrl-C once more leaves that to servotap recover")
        elif number == signal.SIGINT and time.monotonic() - self._told > _AGAIN_S:
            self._supervisor.give_up()
