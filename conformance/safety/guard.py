"""The guard: a process that owns the port, and outlives the suite that talks through it.

    python -m conformance.safety.guard        requests on standard input, answers on standard output

It sends what the suite asks for, if its gate permits it. It knows from the sent frames which drives may be moving. An end of
the suite (an error, kill -9, a closed terminal) ends the pipe. The guard then stops every drive that may be moving, restores
the settings in the journal, and closes the port. A run without an end is stopped after a time even while the suite lives.
A suite that asks nothing for a while is suspended (Ctrl-Z), hangs, or waits for a terminal that takes no more: then the guard
stops what may be moving, too. A port that goes and comes back is opened anew, so that a motor can be stopped after all.
Its own exit status, where the suite has gone, is 21 when all stands, and 20 where a motor could not be stopped.

The permissions of the start hold until the end, also against a faulty suite. Only stops and the journal's old settings pass
in addition.
"""

from __future__ import annotations

import contextlib
import io
import os
import queue
import signal
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import msgspec

from analyzer import dialects
from analyzer.catalogue import Dialect, Risk, Verb
from analyzer.cli.boundary import bounded
from analyzer.errors import ServotapError
from analyzer.live import endpoint as endpoints
from analyzer.records import CanFrame
from analyzer.system import own_process
from analyzer.system.decoding import UNDECODABLE
from analyzer.values import printable
from conformance.bus.lasting import LastingLine
from conformance.bus.line import LineLost
from conformance.claim import NotStopped, RigFault
from conformance.gate.bounds import stops
from conformance.gate.gate import Allowance, Gate, Interpretation, Refused
from conformance.safety import journal as journals
from conformance.safety import messages as say
from conformance.safety.keeper import PUTTING_BACK, link_changed, restore
from conformance.safety.stopping import MAY_MOVE, not_stopped, standing_failure, stop_or_cut, stopping
from conformance.talk.dialogue import Dialogue
from conformance.talk.drive_state import read_drive_state

#: The subdivision that is sent as 0.
LARGEST = 256
_TICK_SECONDS = 0.2
_STDERR = 2
#: How long the guard may take alone to stop one drive, with all that comes before.
_ALONE_SECONDS = 180.0
#: How long the last words of the guard may take.
_LAST_WORDS_SECONDS = 1.0
#: What is told before a motor is stopped: two stops by a ramp, two at once, a port to wait for, and the user's power command.
_LONG = say.Busy(60.0)
#: What learns that the guard has stopped a motor by itself; what a suite tells is taken all the same.
_ON_THE_LINE = (say.Send, say.Receive, say.ReadState)
#: Signals that must not end the guard before the motor stands; the end of the pipe does.
_SHIELDED = ("SIGINT", "SIGTERM", "SIGHUP", "SIGPIPE")


@dataclass
class _Watched:
    """One drive, or all of a dialect by the address of all.

    `moving`: something was sent that may move it, and no stop was proved since. `endless_since`: when it began what ends only
    by a stop. `asked`: a stop was sent since, and not looked at yet. `told`: the suite has said since that it stands.
    """

    dialect: Dialect
    address: int
    moving: bool = False
    endless_since: float | None = None
    asked: bool = False
    told: bool = False

    def concerned(self, asked: Interpretation, *, alone: bool) -> bool:
        """Say whether a request may be taken by the drive. `alone`: there is no other, and a faulty one may take any."""
        if self.address == self.dialect.broadcast:
            return asked.to_many and not asked.slot and asked.dialect.name == self.dialect.name
        return asked.to_many or alone or asked.address in (None, self.address)

    def stands(self) -> None:
        """Take it that it was seen standing."""
        self.moving, self.endless_since, self.asked, self.told = False, None, False, False


class Guard:
    """The port, its gate, and the drives that are looked after."""

    def __init__(self, begin: say.Begin) -> None:
        self._begin = begin
        endpoint = endpoints.parse(begin.endpoint)
        self.line = LastingLine(endpoint, lambda: self.moving)
        self._full = begin.allowance
        # While the drive is looked for: reads, and those to any address.
        self._drives = [_Watched(_dialect(d), d.address, begin.moving) for d in begin.drives]
        spoken = {d.name: d for d in dialects.every()} | {d.dialect.name: d.dialect for d in self._drives}
        self.gate = Gate(self.line, Allowance(subdivision=begin.allowance.subdivision), dialects=spoken.values())
        self._not_stopped: NotStopped | None = None
        #: The subdivision that was last sent, None: none was.
        self._subdivision: int | None = None

    # --- what the suite asks for --------------------------------------------------------------------------------------

    def send(self, request: say.Send) -> say.Answer:
        item = say.sendable(request.item, self.line.endpoint.name)
        gate = self._gate_for(item)
        # Note it before it leaves: from then on the drive may be moving, even if sending fails.
        for reading in gate.interpret(item):
            self._note(reading)
        return say.Done(gate.send(item), self.moving)

    @property
    def moving(self) -> bool:
        """Whether a drive may be moving, as far as the suite has said."""
        return any(drive.moving and not drive.told for drive in self._drives)

    def _gate_for(self, item: bytes | CanFrame) -> Gate:
        """Return the gate that an item has to pass: a stop, and what puts back what was there, have one of their own."""
        if not self.gate.objections(item):
            return self.gate
        whole = [r for r in self.gate.interpret(item) if r.fits and not r.reads_only]
        drive = next((d for d in self._drives if all(r.address == d.address for r in whole)), None)
        if whole and drive is not None and all(stops(r) for r in whole):
            return self.gate.under(stopping(drive.address))
        if whole and self._puts_back(whole):
            return self.gate.under(PUTTING_BACK)
        return self.gate

    def _puts_back(self, readings: list[Interpretation]) -> bool:
        """Say whether all that is sent is what the journal says was there."""
        if not self._begin.journal or not Path(self._begin.journal).exists():
            return False
        changes = journals.open_changes(journals.read(Path(self._begin.journal)))
        there = [(c.command, dict(c.values)) for c in changes]
        return all(r.command is not None and (r.command.name, dict(r.values)) in there for r in readings)

    def _note(self, reading: Interpretation) -> None:
        if reading.command is not None and reading.command.verb is Verb.SET_SUBDIVISION and reading.fits:
            self._subdivision = reading.values.get("subdivision", 0) or LARGEST
        if not reading.risks & MAY_MOVE:
            return
        for drive in self._drives:
            if not drive.concerned(reading, alone=self._begin.allowance.alone):
                continue
            if stops(reading):
                drive.asked = drive.endless_since is not None
                drive.endless_since = time.monotonic() if drive.asked else None
                continue
            drive.moving, drive.asked, drive.told = True, False, False
            endless = Risk.UNBOUNDED in reading.risks
            drive.endless_since = (drive.endless_since or time.monotonic()) if endless else None

    def receive(self, request: say.Receive) -> say.Answer:
        got = self.gate.receive(request.timeout_ns)
        return say.Got(None if got is None else say.wire(got), self.line.passed)

    def speed(self, request: say.Speed) -> say.Answer:
        self.gate.set_speed(request.bits_per_second)
        return say.Done(self.gate.now_ns())

    def drive_found(self, request: say.DriveFound) -> say.Answer:
        """Let pass what was allowed."""
        self.gate = self.gate.under(self._full)
        return say.Done(self.gate.now_ns())

    def read_state(self, request: say.ReadState) -> say.Answer:
        """Ask the drives where they stand: what the suite says of it would not be proof."""
        for drive in [d for d in self._drives if d.address != d.dialect.broadcast]:
            read_drive_state(Dialogue(self.gate, [drive.dialect]), drive.dialect, drive.address)
        return say.Done(self.gate.now_ns())

    def cannot(self, request: say.Request) -> say.Answer:
        """Answer what has no place here: a second beginning."""
        return say.Failed("usage", f"the port is open already, and {type(request).__name__} was asked for")

    def standing(self, request: say.Standing) -> say.Answer:
        """Take the suite's word that the drives stand; it is no proof, so they are looked at in the end all the same."""
        for drive in self._drives:
            drive.endless_since, drive.asked, drive.told = None, False, True
        return say.Done(self.gate.now_ns())

    def all_put_back(self, request: say.AllPutBack) -> say.Answer:
        """Take it that the subdivision is the user's again, if that is what was sent last."""
        if self._begin.allowance.subdivision is not None and self._subdivision == self._begin.allowance.subdivision:
            self.gate.note_subdivision(self._begin.allowance.subdivision)
        return say.Done(self.gate.now_ns())

    # --- what the guard does by itself --------------------------------------------------------------------------------

    def stop_unattended(self, silent_seconds: float) -> str:
        """Stop what is overdue, and after the suite's silence of so many seconds what may be moving.

        Return what was done, or nothing. Raises NotStopped.
        """
        longest = self._begin.longest_silence_ns / 1e9
        overdue = self.stop_overdue()
        if overdue or silent_seconds < longest or not self.moving:
            return overdue
        self.stop_all()
        return f"the suite asked nothing for {longest:g} s while a motor may turn, so the guard has stopped it"

    def stop_overdue(self, begins: Callable[[], object] = lambda: None) -> str:
        """Stop what has run without an end for too long; return what was done, or nothing. Raises NotStopped.

        `begins` is called before that takes time.
        """
        longest = self._begin.longest_run_ns / 1e9
        now = time.monotonic()
        late = [d for d in self._drives if d.endless_since is not None and now - d.endless_since > longest]
        if late:
            begins()
        for drive in [d for d in late if d.asked]:
            # A stop was sent, and the suite has not reported whether the drive stands.
            if not standing_failure(self.gate, drive.dialect, drive.address):
                drive.stands()
                late.remove(drive)
        if not late:
            return ""
        self.stop_all()
        return f"a run without an end took longer than {longest:g} s (--max-run), so the guard has stopped the motor"

    def stop_unproved(self) -> None:
        """Stop every drive that is not seen standing, at the end of a run. Raises NotStopped."""
        for drive in self._drives:
            if drive.moving and drive.told and not standing_failure(self.gate, drive.dialect, drive.address):
                drive.stands()
        self.stop_all()

    def stop_all(self) -> None:
        """Stop every drive that may be moving. Raises NotStopped, after all were tried."""
        if self._not_stopped is not None:
            # All was tried, and the power was cut: nothing gets better by doing it again.
            raise self._not_stopped
        for drive in self._drives:
            if not drive.moving:
                continue
            try:
                stop_or_cut(self.gate, drive.dialect, drive.address, self._begin.cut_power)
                drive.stands()
            except NotStopped as error:
                drive.endless_since, self._not_stopped = None, error
        if self._not_stopped is not None:
            raise self._not_stopped

    @property
    def watched(self) -> int:
        """How many drives are looked after."""
        return len(self._drives)

    def cut_what_turns(self) -> bool:
        """Cut the power of drives that may be moving and are not stopped; return whether there are any."""
        left = [drive for drive in self._drives if drive.moving and not drive.told] if self._not_stopped is None else []
        for drive in left:
            not_stopped(drive.dialect, drive.address, "the suite has gone, and its port hangs", self._begin.cut_power)
        return bool(left)

    def restore_link(self) -> None:
        """Bring drives that may answer elsewhere back to where they can be stopped."""
        path = Path(self._begin.journal)
        if self._begin.journal and path.exists() and link_changed(path):
            restore(path, self.gate, dict_of(self._drives), link_only=True)

    def put_back(self) -> None:
        """Put back what the journal says was changed and not put back."""
        path = Path(self._begin.journal)
        if not self._begin.journal or not path.exists():
            return
        failure = restore(path, self.gate, dict_of(self._drives))
        if failure:
            raise RigFault(f"{failure}; servotap restore {path} puts it back")


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
    except (EOFError, OSError, *UNDECODABLE):
        into.put(None)


def _watch(reader: threading.Thread, guard: Guard) -> None:
    """End this process where a motor is not stopped long after the suite has gone: the driver of a port may hang for ever."""
    reader.join()
    time.sleep(_ALONE_SECONDS * guard.watched)
    if guard.cut_what_turns():
        # What was said is written first.
        sys.stderr.close()
        own_process.end(NotStopped.exit_status)


class Aside(io.TextIOBase):
    """A text stream of which a thread writes the lines to a descriptor: writing to it waits for no reader."""

    def __init__(self, descriptor: int) -> None:
        self._descriptor = descriptor
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._line = ""
        self._thread = threading.Thread(target=self._pass_on, daemon=True)
        self._thread.start()

    def write(self, text: str) -> int:
        """Take a text, cleaned."""
        *lines, self._line = (self._line + printable(text, "\n\t")).split("\n")
        for line in lines:
            self._lines.put(f"{line}\n")
        return len(text)

    def close(self) -> None:
        """Wait until all is written, but not for a reader that has stalled."""
        if not self.closed:
            self._lines.put(self._line)
            self._lines.put(None)
            self._thread.join(_LAST_WORDS_SECONDS)
        super().close()

    def _pass_on(self) -> None:
        while (line := self._lines.get()) is not None:
            left = line.encode(errors="backslashreplace")
            # Not through a buffer: its lock would be held by this thread when the process ends.
            with contextlib.suppress(OSError), io.FileIO(self._descriptor, "wb", closefd=False) as stream:
                # A descriptor that does not wait takes nothing now and then: the rest of the line is lost.
                while left and (taken := stream.write(left)):
                    left = left[taken:]


def main() -> int:
    """Serve one suite until it ends or dies; return the exit status."""
    # Before a motor stands, what is told of another one must not wait.
    with contextlib.closing(Aside(_STDERR)) as aside, contextlib.redirect_stderr(aside):
        return _guard()


def _guard() -> int:
    for name in _SHIELDED:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    # What a library prints must not stand among the answers.
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(_STDERR, sys.stdout.fileno())
    requests: queue.Queue[say.Request | None] = queue.Queue()
    # Without a buffer: its lock would be held by the reading thread when the process ends.
    orders = os.fdopen(os.dup(sys.stdin.fileno()), "rb", buffering=0)
    reader = threading.Thread(target=_reader, args=(orders, requests), daemon=True)
    reader.start()
    begin = requests.get()
    if not isinstance(begin, say.Begin):
        return 2
    try:
        guard = Guard(begin)
    except ServotapError as error:
        _answer(answers, say.Failed("usage", str(error)))
        return 2
    _answer(answers, say.Done(guard.gate.now_ns()))
    threading.Thread(target=_watch, args=(reader, guard), daemon=True).start()
    try:
        return _serve(guard, requests, answers)
    finally:
        guard.line.close()


def _serve(guard: Guard, requests: queue.Queue[say.Request | None], answers: IO[bytes]) -> int:
    table: dict[type, Callable[[Guard, say.Request], say.Answer]] = {
        say.Send: Guard.send,  # type: ignore[dict-item]  # each takes its own kind of request
        say.Receive: Guard.receive,  # type: ignore[dict-item]
        say.Speed: Guard.speed,  # type: ignore[dict-item]
        say.DriveFound: Guard.drive_found,  # type: ignore[dict-item]
        say.ReadState: Guard.read_state,  # type: ignore[dict-item]
        say.Standing: Guard.standing,  # type: ignore[dict-item]
        say.AllPutBack: Guard.all_put_back,  # type: ignore[dict-item]
    }
    stopped: say.Failed | None = None
    answered = time.monotonic()
    while True:
        try:
            request = requests.get(timeout=_TICK_SECONDS)
        except queue.Empty:
            # There is no question yet, so nothing is answered.
            stopped = stopped or _stopped(partial(guard.stop_unattended, time.monotonic() - answered))
            continue
        if request is None:
            return _finish_alone(guard)
        if isinstance(request, say.End):
            return _finish(guard, answers, request)
        stopped = stopped or _stopped(lambda: guard.stop_overdue(lambda: _answer(answers, _LONG)))
        if stopped is not None and (stopped.kind == "not stopped" or isinstance(request, _ON_THE_LINE)):
            answer: say.Answer = stopped
            # Of a motor that turns on there is nothing else to say.
            stopped = stopped if stopped.kind == "not stopped" else None
        else:
            if guard.line.lost:
                _answer(answers, _LONG)
            answer = _done(table.get(type(request), Guard.cannot), guard, request)
        if not _answer(answers, answer):
            return _finish_alone(guard)
        answered = time.monotonic()


def _done(act: Callable[[Guard, say.Request], say.Answer], guard: Guard, request: say.Request) -> say.Answer:
    try:
        return act(guard, request)
    except Refused as error:
        return say.Failed("refused", str(error))
    except LineLost as error:
        return say.Failed("lost", str(error))
    except ServotapError as error:
        return say.Failed("usage", str(error))
    # No error of one request may end this process, for it has to stop the motor.
    except Exception as error:
        return say.Failed("usage", f"{type(error).__name__}: {error}")


def _stopped(stop: Callable[[], str]) -> say.Failed | None:
    """Stop what the guard has to stop by itself; return what to report to the suite, if anything."""
    try:
        stopped = stop()
    except NotStopped as error:
        return say.Failed("not stopped", str(error))
    except LineLost as error:
        return say.Failed("lost", str(error))
    return say.Failed("stopped", stopped) if stopped else None


def _finish(guard: Guard, answers: IO[bytes], request: say.End) -> int:
    """End as the suite asks for it, with nothing moving; return the exit status."""
    _answer(answers, _LONG)
    try:
        if not request.given_up:
            guard.stop_unproved()
    except NotStopped as error:
        _answer(answers, say.Failed("not stopped", str(error)))
        return NotStopped.exit_status
    except ServotapError as error:
        _answer(answers, say.Failed("lost", str(error)))
        return RigFault.exit_status
    _answer(answers, say.Done(guard.gate.now_ns()))
    return 0


def _finish_alone(guard: Guard) -> int:
    """Do what has to be done when the suite has died; return the exit status."""
    # What goes wrong with a link, however, must not keep the motor from being stopped.
    try:
        guard.restore_link()
    except Exception as error:
        print(f"servotap: {type(error).__name__}: {error}", file=sys.stderr, flush=True)
    try:
        guard.stop_all()
    except NotStopped:
        return NotStopped.exit_status
    try:
        guard.put_back()
    except Exception as error:
        print(f"servotap: not all settings were put back: {error}", file=sys.stderr, flush=True)
    return say.STANDS


def _answer(stream: IO[bytes], answer: say.Answer) -> bool:
    """Answer; return False where the suite has gone."""
    try:
        say.put(stream, answer)
    except OSError:
        return False
    return True


if __name__ == "__main__":
    own_process.take()
    # It writes to the terminal of the suite.
    status = bounded(lambda words: main(), sys.argv[1:])
    # A thread of a driver would hold it up.
    own_process.end(status)
