"""A line whose port is owned by a guard: the suite's end of the pipe."""

from __future__ import annotations

import subprocess
import sys
import time
from typing import IO, cast

import msgspec

from analyzer.endpoint import Endpoint
from analyzer.errors import ServotapError, UsageError
from analyzer.records import CanFrame, Chunk
from conformance.line import Line, LineLost
from conformance.rig import NotStopped
from conformance.safety import messages as say

_KINDS: dict[str, type[ServotapError]] = {
    "refused": UsageError,
    "lost": LineLost,
    "usage": UsageError,
    "stopped": LineLost,
    "not stopped": NotStopped,
}
#: How long the guard may take to stop motors and put settings back before it is left alone.
_FAREWELL_SECONDS = 60


class GuardedLine(Line):
    """A line by way of a guard process. Raises UsageError where the port cannot be opened."""

    def __init__(self, endpoint: Endpoint, begin: say.Begin) -> None:
        self.endpoint = endpoint
        # In a session of its own: what ends the suite's terminal must not end the guard.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "conformance.safety.guard"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        self._to = cast(IO[bytes], self._process.stdin)
        self._from = cast(IO[bytes], self._process.stdout)
        self._decode = msgspec.msgpack.Decoder(say.Answer).decode
        self._closed = False
        try:
            begun = self._ask(begin)
        except ServotapError:
            self._process.wait(_FAREWELL_SECONDS)
            raise
        assert isinstance(begun, say.Done)  # every other answer raises
        self._ahead_ns = begun.t_ns - time.monotonic_ns()
        self.anchor_ns = time.time_ns() - begun.t_ns

    def _ask(self, request: say.Request) -> say.Done | say.Got:
        try:
            say.put(self._to, request)
            answer = self._decode(say.take(self._from))
        except (OSError, EOFError, ValueError) as error:
            raise LineLost(f"{self.endpoint.text}: the process that owns the port has gone ({error})") from None
        if isinstance(answer, say.Failed):
            raise _KINDS[answer.kind](answer.text)
        return cast("say.Done | say.Got", answer)

    def now_ns(self) -> int:
        """Return the time of the guard's clock: both are the monotonic clock of one machine."""
        return time.monotonic_ns() + self._ahead_ns

    def write(self, item: bytes | CanFrame) -> int:
        """Have the guard judge and send an item. Only a gate calls this."""
        done = self._ask(say.Send(say.wire(item)))
        return done.t_ns if isinstance(done, say.Done) else self.now_ns()

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        """Return what comes next, None when the time is over."""
        got = self._ask(say.Receive(max(0, timeout_ns)))
        if isinstance(got, say.Got) and got.item is not None:
            return say.received(got.item, self.endpoint.name)
        return None

    def set_speed(self, bits_per_second: int) -> None:
        """Change this end's speed."""
        self._ask(say.Speed(bits_per_second))

    def close(self) -> None:
        """Tell the guard that all is done, and wait until the port is free."""
        if self._closed:
            return
        self._closed = True
        try:
            self._ask(say.End())
        except LineLost:
            pass  # it has gone already, and the port with it
        finally:
            self._to.close()
            self._process.wait(_FAREWELL_SECONDS)
            self._from.close()

    def abandon(self) -> int:
        """Leave without a word, so that the guard stops and puts back by itself; return its exit status."""
        self._closed = True
        self._to.close()
        status = self._process.wait(_FAREWELL_SECONDS)
        self._from.close()
        return status
