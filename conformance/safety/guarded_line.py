"""A line whose port is owned by a guard: the suite's end of the pipe.

A question and its answer are one: a Ctrl-C between them waits until the answer has come, or the next question would get it.
Every answer has a deadline. A guard that misses it is frozen or hangs: it is killed, so that another one can take the port.
"""

from __future__ import annotations

import contextlib
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from math import ceil
from pathlib import Path
from typing import IO, cast

import msgspec

from analyzer.catalogue import Dialect
from analyzer.errors import ServotapError, UsageError
from analyzer.live.endpoint import Endpoint
from analyzer.records import CanFrame, Chunk
from conformance.bus.line import Line, LineLost
from conformance.claim import Inconclusive, NotStopped
from conformance.gate.budget import Spent
from conformance.gate.gate import Allowance, Refused
from conformance.safety import messages as say
from conformance.safety.signals import deferred
from conformance.safety.stopping import GuardLost

_ROOT = Path(__file__).parents[2]
#: How long the guard may take to stop motors and put settings back before it is killed.
_FAREWELL_SECONDS = 60.0
#: How long the end of one that was killed is waited for.
_KILLED_SECONDS = 3.0
#: How long it may take to start, and to answer beside what was asked for. A busy machine is slow at times.
_START_SECONDS = 30.0
_ANSWER_SECONDS = 3.0
#: How much longer for what it has to ask the drive.
_LOOK_SECONDS = 10.0
_WAIT_SECONDS = 0.5
#: Waits are cut into pieces, so that a Ctrl-C is not held up for long.
_PIECE_NS = 200_000_000


class RefusedByGuard(Refused):
    """The guard's gate did not let an item through."""

    def __init__(self, text: str) -> None:
        super().__init__(b"", ())
        self.args = (text,)


_KINDS: dict[str, Callable[[str], Exception]] = {
    "refused": RefusedByGuard,
    "lost": LineLost,
    "usage": UsageError,
    "stopped": Inconclusive,
    "not stopped": NotStopped,
}


def beginning(endpoint: Endpoint, drives: Iterable[tuple[Dialect, int]], allowance: Allowance) -> say.Begin:
    """Return what a guard is told first. `drives`: those that it looks after, which alone may be meant where not all may."""
    watched = tuple(say.Drive(dialect.name, dialect.model, address) for dialect, address in drives)
    addresses = None if allowance.addresses is None else frozenset(drive.address for drive in watched)
    budget = replace(allowance.budget, path=None, spent=Spent())
    return say.Begin(endpoint.text, watched, replace(allowance, addresses=addresses, budget=budget))


class GuardedLine(Line):
    """A line by way of a guard process.

    `not_stopped`: the guard has said that a motor turns on. `settled`: in the end nothing is left to be stopped.

    Raises UsageError where the port cannot be opened.
    """

    def __init__(self, endpoint: Endpoint, begin: say.Begin) -> None:
        self.endpoint = endpoint
        # In a session of its own: what ends the suite's terminal must not end the guard. Without the working directory on
        # its path, in which anything may lie.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "conformance.safety.guard"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            # A buffer is locked while a thread reads from it, and a guard that hangs in a driver may never end that.
            bufsize=0,
            start_new_session=True,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))},
        )
        self._to = cast(IO[bytes], self._process.stdin)
        self._from = cast(IO[bytes], self._process.stdout)
        #: Answers as they come, and None at the end.
        self._answers: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._reader = threading.Thread(target=_read, args=(self._from, self._answers), daemon=True)
        self._reader.start()
        self._decode = msgspec.msgpack.Decoder(say.Answer).decode
        self._closed = False
        self._patience = _FAREWELL_SECONDS
        self._passed = 0
        self.not_stopped: NotStopped | None = None
        #: Whether a drive may be moving: the suite or the guard sent a motion, and nothing has shown a standstill since.
        self.moving = False
        self.settled = False
        try:
            begun = self._ask(begin)
        except ServotapError:
            self._leave()
            raise
        assert isinstance(begun, say.Done)  # every other answer raises
        self._ahead_ns = begun.t_ns - time.monotonic_ns()
        self.anchor_ns = time.time_ns() - begun.t_ns

    def _ask(self, request: say.Request) -> say.Done | say.Got:
        with deferred():
            try:
                say.put(self._to, request)
                answer = self._answer(_seconds(request))
            except queue.Empty:
                self._kill()
                raise GuardLost(f"{self.endpoint.text}: the process that owns the port did not answer and was killed") from None
            except (OSError, EOFError, ValueError) as error:
                raise GuardLost(f"{self.endpoint.text}: the process that owns the port has gone ({error})") from None
        if isinstance(answer, say.Failed):
            failed = _KINDS[answer.kind](answer.text)
            if isinstance(failed, NotStopped):
                self.not_stopped = failed
            raise failed
        return cast("say.Done | say.Got", answer)

    def _answer(self, seconds: float) -> say.Answer:
        """Return the answer to what was asked. Raises EOFError, queue.Empty where none comes in time.

        The time is counted in waits: while this process itself is suspended, no guard is late.
        """
        waits = ceil(seconds / _WAIT_SECONDS)
        while True:
            try:
                message = self._answers.get(timeout=_WAIT_SECONDS)
            except queue.Empty:
                waits -= 1
                if not waits:
                    raise
                continue
            if message is None:
                raise EOFError("no answer")
            answer: say.Answer = self._decode(message)
            if not isinstance(answer, say.Busy):
                return answer
            waits = ceil(answer.seconds / _WAIT_SECONDS)

    def tell(self, request: say.DriveFound | say.ReadState | say.Standing | say.AllPutBack) -> None:
        """Tell the guard something. Raises LineLost."""
        self._ask(request)
        if isinstance(request, say.Standing):
            self.moving = False

    @property
    def passed(self) -> int:
        """Bytes that came to the guard's port and were not read."""
        return self._passed

    def now_ns(self) -> int:
        """Return the time of the guard's clock: both are the monotonic clock of one machine."""
        return time.monotonic_ns() + self._ahead_ns

    def write(self, item: bytes | CanFrame) -> int:
        """Have the guard judge and send an item. Only a gate calls this.

        Raises Refused where the guard does not let it through, LineLost; Inconclusive where the guard had to stop the motor.
        """
        done = self._ask(say.Send(say.wire(item)))
        assert isinstance(done, say.Done)  # every other answer raises
        self.moving = done.moving
        return done.t_ns

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        until_ns = self.now_ns() + max(0, timeout_ns)
        while True:
            left_ns = max(0, until_ns - self.now_ns())
            got = self._ask(say.Receive(min(left_ns, _PIECE_NS)))
            assert isinstance(got, say.Got)  # every other answer raises
            self._passed = got.passed
            if got.item is not None:
                return say.received(got.item, self.endpoint.name)
            if left_ns <= _PIECE_NS:
                return None

    def set_speed(self, bits_per_second: int) -> None:
        self._ask(say.Speed(bits_per_second))
        self.endpoint = self.endpoint.at(bits_per_second)

    def close(self) -> None:
        """Tell the guard that all is done, and wait until the port is free. Raises NotStopped."""
        if self._closed:
            return
        try:
            self._ask(say.End(given_up=self.settled or self.not_stopped is not None))
        except LineLost:
            pass  # it has gone already, and the port with it
        finally:
            self._leave()

    def abandon(self) -> int | None:
        """Leave without a word, so that the guard stops and puts back by itself; return its exit status, as `guard` has it.

        None: it did not end, and was killed.
        """
        return self._process.returncode if self._closed else self._leave()

    def _leave(self) -> int | None:
        self._closed = True
        with contextlib.suppress(OSError):
            self._to.close()
        try:
            return self._process.wait(self._patience)
        except subprocess.TimeoutExpired:
            self._kill()
            return None
        finally:
            self._reader.join(_KILLED_SECONDS)
            self._from.close()

    def _kill(self) -> None:
        """Kill the guard. One that hangs in the driver of its port may outlive that: the motor must not wait for it."""
        self._process.kill()
        self._patience = _KILLED_SECONDS
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(self._patience)


def _read(stream: IO[bytes], into: queue.SimpleQueue[bytes | None]) -> None:
    try:
        while True:
            into.put(say.take(stream))
    except (EOFError, OSError, ValueError):
        into.put(None)


def _seconds(request: say.Request) -> float:
    """Return how long the answer to a request may take."""
    match request:
        case say.Begin():
            return _START_SECONDS
        case say.Receive():
            return request.timeout_ns / 1e9 + _ANSWER_SECONDS
        case say.ReadState():
            return _LOOK_SECONDS
        case _:
            return _ANSWER_SECONDS
