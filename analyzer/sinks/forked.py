"""A process that is forked from this one, with a pipe each way. Both carry messages.

Rules: Ctrl-C and its like reach the parent alone, which decides what they mean. A child whose parent is gone reads the end of
its pipe, and ends. A child that is gone gives empty answers.
"""

from __future__ import annotations

import contextlib
import io
import os
import signal
from collections.abc import Callable

from analyzer.system import sized

try:
    import fcntl
except ImportError:  # Windows, which forks nothing
    fcntl = None  # type: ignore[assignment]

#: Bytes that a pipe is to hold, where the system lets one say so: fewer turns for a long message.
_PIPE = 1 << 20
#: What this process holds of all its pipes: while a child held such an end too, the other end would not learn of our death.
_held: set[io.FileIO] = set()


def available() -> bool:
    """Say whether this machine can fork, and has more than one core to run what is forked."""
    return hasattr(os, "fork") and (os.cpu_count() or 1) > 1


class Ends:
    """What one side reads messages from and writes them to."""

    def __init__(self, source: io.FileIO, target: io.FileIO) -> None:
        self.source = source
        self._target = target

    def give(self, data: bytes) -> None:
        """Send a message. Raises BrokenPipeError where the other side has gone."""
        sized.put(self._target, data)

    def take(self) -> bytearray:
        """Return the next message; nothing where the other side has gone."""
        return sized.take(self.source)

    def close(self) -> None:
        for end in (self.source, self._target):
            end.close()
            _held.discard(end)


class Forked(Ends):
    """A child that runs `work` and ends when that returns."""

    def __init__(self, work: Callable[[Ends], None]) -> None:
        ends, childs = _pair()
        self.process = os.fork()
        if self.process == 0:
            # The parent decides what Ctrl-C means.
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.SIG_IGN)
            status = 1
            try:
                for end in (*_held, *ends):
                    end.close()
                work(Ends(*childs))
                status = 0
            except BrokenPipeError:
                status = 0  # no one is left to tell
            finally:
                os._exit(status)
        for end in childs:
            end.close()
        _held.update(ends)
        super().__init__(*ends)

    @property
    def alive(self) -> bool:
        """Whether its end was not waited for yet."""
        return self.process > 0

    def kill(self) -> None:
        if self.alive:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.process, signal.SIGKILL)

    def ended(self) -> str:
        """Let it end, wait for that, and say how it came."""
        self.close()
        if not self.alive:
            return ""
        status = os.waitstatus_to_exitcode(os.waitpid(self.process, 0)[1])
        self.process = 0
        return f"signal {-status}" if status < 0 else f"status {status}"


def _pair() -> tuple[tuple[io.FileIO, io.FileIO], tuple[io.FileIO, io.FileIO]]:
    """Return both sides of two pipes: what is read from and what is written to."""
    down, up = os.pipe(), os.pipe()
    for _, write in (down, up):
        size = getattr(fcntl, "F_SETPIPE_SZ", None)
        if size is not None:
            # The system may allow less.
            with contextlib.suppress(OSError):
                fcntl.fcntl(write, size, _PIPE)
    return (io.FileIO(up[0], "rb"), io.FileIO(down[1], "wb")), (io.FileIO(down[0], "rb"), io.FileIO(up[1], "wb"))
