"""The guard: a process that owns the port, and outlives the suite that talks through it.

    python -m conformance.safety.guard        requests on standard input, answers on standard output

It sends what it is told to send, if its gate lets it. It knows which drives may be moving by what it sent them. Whatever
ends the suite (an error, kill -9, a closed terminal) ends the pipe, and then the guard stops every drive that may be
moving, puts back what the journal says, and gives the port back. A run without an end is stopped after a time even while
the suite lives. Its own exit status is 0, or 20 where a motor could not be stopped.
"""

from __future__ import annotations

import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import msgspec

from analyzer import dialects
from analyzer import endpoint as endpoints
from analyzer.catalogue import Dialect, Risk
from analyzer.errors import ServotapError, UsageError
from conformance.bounds import STOPS
from conformance.gate import Allowance, Budget, Gate, Reading, Refused
from conformance.line import LineLost
from conformance.lines import open_line
from conformance.rig import NotStopped
from conformance.safety import messages as say
from conformance.safety.restoring import restore
from conformance.safety.stopping import stop_or_cut

NOT_STOPPED = 20
#: The suite counts the budget of its run; here nothing is counted twice.
_UNCOUNTED = 1 << 60
_TICK_SECONDS = 0.2
#: Signals that must not end the guard before the motor stands; the end of the pipe does.
_SHIELDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGPIPE")


@dataclass
class _Watched:
    """One drive. `moving`: something was sent that may move it, and no stop was proved since."""

    dialect: Dialect
    address: int
    moving: bool = False
    endless_since: float | None = None


class Guard:
    """The port, its gate, and the drives that are looked after."""

    def __init__(self, begin: say.Begin) -> None:
        self._begin = begin
        endpoint = endpoints.parse(begin.endpoint)
        self.line = open_line(endpoint)
        self.gate = Gate(
            self.line,
            Allowance(
                frozenset(Risk(word) for word in begin.risks),
                begin.speed,
                begin.turns,
                begin.acceleration,
                begin.current,
                frozenset(d.address for d in begin.drives),
                begin.alone,
                Budget(wear=_UNCOUNTED),
                begin.subdivision,
            ),
        )
        self._drives = [_Watched(_dialect(d), d.address) for d in begin.drives]

    def send(self, request: say.Send) -> say.Answer:
        """Judge and write an item."""
        item = say.sendable(request.item, self.line.endpoint.name)
        readings = self.gate.judge(item)
        # Before it leaves: from then on the drive may be moving, whatever happens here.
        for reading in readings:
            self._note(reading)
        return say.Done(self.gate.send(item))

    def _note(self, reading: Reading) -> None:
        if reading.command is None or not reading.risks & {Risk.MOTION, Risk.UNBOUNDED, Risk.UNKNOWN, Risk.POWER_ON}:
            return
        for drive in self._drives:
            if not (reading.to_many or reading.address in (None, drive.address)):
                continue
            if reading.command.verb in STOPS:
                drive.endless_since = None
                continue
            drive.moving = True
            endless = Risk.UNBOUNDED in reading.risks
            drive.endless_since = (drive.endless_since or time.monotonic()) if endless else None

    def receive(self, request: say.Receive) -> say.Answer:
        """Wait for what comes next."""
        got = self.gate.receive(request.timeout_ns)
        return say.Got(None if got is None else say.wire(got))

    def speed(self, request: say.Speed) -> say.Answer:
        """Change the host's speed."""
        self.gate.set_speed(request.bits_per_second)
        return say.Done(self.gate.now_ns())

    def overdue(self) -> bool:
        """Say whether a run without an end has taken too long."""
        longest = self._begin.longest_run_ns / 1e9
        now = time.monotonic()
        return any(d.endless_since is not None and now - d.endless_since > longest for d in self._drives)

    def stop_all(self) -> None:
        """Stop every drive that may be moving. Raises NotStopped, after all were tried."""
        trouble: NotStopped | None = None
        for drive in self._drives:
            if not drive.moving:
                continue
            try:
                # A stop always passes, whatever the suite was allowed.
                stopping = Allowance(frozenset({Risk.READ, Risk.MOTION}), addresses=frozenset({drive.address}))
                stop_or_cut(self.gate.under(stopping), drive.dialect, drive.address, self._begin.cut_power)
                drive.moving, drive.endless_since = False, None
            except NotStopped as error:
                trouble = error
        if trouble is not None:
            raise trouble

    def put_back(self) -> None:
        """Put back what the journal says was changed and not put back."""
        if self._begin.journal and Path(self._begin.journal).exists():
            told = restore(Path(self._begin.journal), self.gate, dict_of(self._drives))
            if told:
                print(f"servotap: not all settings were put back: {told}", file=sys.stderr, flush=True)


def dict_of(drives: list[_Watched]) -> dict[int, Dialect]:
    """Return the drives' dialects by address."""
    return {drive.address: drive.dialect for drive in drives}


def _dialect(drive: say.Drive) -> Dialect:
    found = dialects.get(drive.dialect)
    return found.for_model(drive.model) if drive.model else found


def _reader(stream: IO[bytes], into: queue.Queue[say.Request | None]) -> None:
    decode = msgspec.msgpack.Decoder(say.Request).decode
    try:
        while True:
            into.put(decode(say.take(stream)))
    except (EOFError, OSError, msgspec.MsgspecError):
        into.put(None)


def main() -> int:
    """Serve one suite until it ends or dies; return the exit status."""
    for name in _SHIELDED:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    # What a library prints must not stand among the answers.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    requests: queue.Queue[say.Request | None] = queue.Queue()
    # Without a buffer: its lock would be held by the reading thread when the process ends.
    orders = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
    threading.Thread(target=_reader, args=(orders, requests), daemon=True).start()
    begin = requests.get()
    if not isinstance(begin, say.Begin):
        return 2
    try:
        guard = Guard(begin)
    except ServotapError as error:
        _answer(answers, say.Failed("usage", str(error)))
        return 2
    _answer(answers, say.Done(guard.gate.now_ns()))
    try:
        return _serve(guard, requests, answers)
    finally:
        guard.line.close()


def _serve(guard: Guard, requests: queue.Queue[say.Request | None], answers: IO[bytes]) -> int:
    table: dict[type, Callable[[Guard, say.Request], say.Answer]] = {
        say.Send: Guard.send,  # type: ignore[dict-item]  # each takes its own kind of request
        say.Receive: Guard.receive,  # type: ignore[dict-item]
        say.Speed: Guard.speed,  # type: ignore[dict-item]
    }
    stopped = ""
    while True:
        try:
            request = requests.get(timeout=_TICK_SECONDS)
        except queue.Empty:
            if not stopped and guard.overdue():
                stopped = "a run without an end took too long; the guard has stopped the motor"
                guard.stop_all()
            continue
        if request is None:
            return _alone(guard)
        if isinstance(request, say.End):
            _answer(answers, say.Done(guard.gate.now_ns()))
            return 0
        try:
            if not stopped and guard.overdue():
                stopped = "a run without an end took too long; the guard has stopped the motor"
                guard.stop_all()
            if stopped and isinstance(request, say.Send):
                answer: say.Answer = say.Failed("stopped", stopped)
                stopped = ""
            else:
                answer = table[type(request)](guard, request)
        except Refused as error:
            answer = say.Failed("refused", str(error))
        except LineLost as error:
            answer = say.Failed("lost", str(error))
        except NotStopped as error:
            answer = say.Failed("not stopped", str(error))
        except UsageError as error:
            answer = say.Failed("usage", str(error))
        if not _answer(answers, answer):
            return _alone(guard)


def _alone(guard: Guard) -> int:
    """Do what has to be done when the suite has died; return the exit status."""
    try:
        guard.stop_all()
    except NotStopped:
        return NOT_STOPPED
    try:
        guard.put_back()
    except ServotapError as error:
        print(f"servotap: not all settings were put back: {error}", file=sys.stderr, flush=True)
    return 0


def _answer(stream: IO[bytes], answer: say.Answer) -> bool:
    """Answer; return False where nobody listens any more."""
    try:
        say.put(stream, answer)
    except OSError:
        return False
    return True


if __name__ == "__main__":
    sys.exit(main())
