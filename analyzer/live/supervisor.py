"""The supervisor of a recording: starts a reader for each port and one decoding process, and sees that they keep running.

    reader, reader, ...  ->  spools  ->  decoding process  ->  log
          ^                    ^                ^
          '------- supervisor: CONTROL ---------'      only files connect them; each can die and is started again

It writes the spool CONTROL: the beginning, what the wall clock does, marks, restarts, the end. It ends in order: the readers
first, then `end` in CONTROL, then it waits for the decoding process to have finished the log. Nothing here touches a port.
"""

from __future__ import annotations

import contextlib
import platform
import queue
import shutil
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from analyzer import __version__
from analyzer.errors import ServotapError, UsageError
from analyzer.live import clock
from analyzer.live.children import SAYS, Child, DecoderChild, MessageQueue, ReaderChild
from analyzer.live.config import CONTROL, FILES, WHOLE, RecordingConfig
from analyzer.live.lock import RUNNING, Lock
from analyzer.live.port_status import PortStatus, take
from analyzer.live.reader_store import Store
from analyzer.live.snapshot import Snapshot
from analyzer.live.spool import SpoolWriter, spool_folder
from analyzer.sources.recording_parts import parts_named
from analyzer.values import SECOND_NS

#: How long a port may take to open at the start (an Arduino behind slcan needs two seconds).
OPEN_S = 15.0
#: How long a reader may take to end; it tries three seconds to store what it holds when a disk is full.
END_S = 10.0
#: Deaths of the decoding process after the end, after which its work is left to `servotap recover`.
LAST_DEATHS = 3
#: How long the decoding process may say nothing while it finishes the log; it normally reports ten times a second.
SILENT_S = 120.0
#: The longest sleep of the loop: how late the clock is looked at and what is due is started.
_TURN_S = 0.25


#: Makes the readers of a recording from the folder of its spools and where they are heard: by one of the stems of each.
ReaderMaker = Callable[[Path, MessageQueue], Mapping[str, Child]]


def ignore(*_: object) -> None:
    """Take a note or a snapshot and do nothing."""


class Taken(UsageError):
    """Another recording has the name of this one."""


class Supervisor:
    """One recording. `run` returns when it is over; `stop` and `mark` may be called from any thread.

    `on_note(bus, text)`: what a user should know, as it happens; bus is empty where it is about all. `on_snapshot`: what the
    decoding process tells. Both are called from the thread of `run`. `plain`: readers as where there is no Linux; `readers`:
    other readers, one of which may store several spools. `replaces`: older logs and spools of this name; they go once all ports
    are open, and stay where this recording does not begin.
    """

    def __init__(
        self,
        config: RecordingConfig,
        *,
        duration_ns: int = 0,
        on_note: Callable[[str, str], None] = ignore,
        on_snapshot: Callable[[Snapshot], None] = ignore,
        plain: bool = False,
        readers: ReaderMaker | None = None,
        replaces: Sequence[Path] = (),
    ) -> None:
        self.config = config
        self.folder = spool_folder(Path(config.log))
        self.tallies = {
            p.stem: PortStatus(bus=p.bus, endpoint=p.endpoint, unit="frames" if p.kind == "can" else "bytes")
            for p in config.ports
        }
        self.snapshot: Snapshot | None = None
        #: Why it ended; empty while it runs.
        self.reason = ""
        #: `starting`, `recording`, `ending`, `finishing`, `over`.
        self.phase = "starting"
        #: What went wrong with the log itself, for the end; empty if nothing.
        self.unfinished = ""
        self.decoder_restarts = 0
        self.began_ns = self.ended_ns = 0
        self._duration_ns = duration_ns
        self._on_note = on_note
        self._on_snapshot = on_snapshot
        self._heard: MessageQueue = queue.SimpleQueue()
        self._readers: dict[str, Child] = (
            {p.stem: ReaderChild(self.folder, p.stem, self._heard, plain=plain) for p in config.ports}
            if readers is None
            else dict(readers(self.folder, self._heard))
        )
        self._decoder: Child = DecoderChild(self.folder, self._heard)
        self._control: Store | None = None
        self._control_lock = threading.Lock()
        self._stopping = threading.Event()
        #: Readers that have ended, once they were asked to; whether the log is finished; deaths while it was to be.
        self._gone: set[str] = set()
        self._decoded = False
        self._deaths = 0
        self._given_up = False
        self._lock: Lock | None = None
        self._replaces = replaces
        #: Where older spools stand until this recording has begun.
        self._aside = self.folder.with_name(f"{self.folder.name}.replaced-{config.anchor_utc_ns}")

    # --- from outside ---------------------------------------------------------------------------------------------

    def stop(self, reason: str) -> None:
        """End the recording; `reason` stands in the log."""
        self.reason = self.reason or reason
        self._stopping.set()
        self._heard.put(("wake", "", None))

    def give_up(self) -> None:
        """Wait no more for the log to be finished: `servotap recover` can do that."""
        self._given_up = True
        self._heard.put(("wake", "", None))

    def mark(self, text: str) -> None:
        """Put a note into the log, at this moment."""
        self._note_event("mark", text=text)

    @property
    def files(self) -> list[Path]:
        """The log, or its parts that are there, in order."""
        config = self.config
        log = Path(config.log)
        if config.rotate_bytes or config.rotate_ns or config.max_total:
            return parts_named(log)
        # It stands elsewhere if something took its name.
        last = log if self.snapshot is None or not self.snapshot.log else Path(self.snapshot.log)
        return [last] if last.exists() else []

    @property
    def processes(self) -> Mapping[str, int]:
        """Process ids by stem; `decoding` is the decoding process."""
        return {name: child.pid for name, child in {**self._readers, "decoding": self._decoder}.items()}

    # --- the run --------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Open all ports and begin. Raises UsageError when one cannot be opened; then nothing is left behind.

        Raises Taken, before any port is opened, where another recording has taken the log's name meanwhile.
        """
        try:
            if self.folder in self._replaces:
                self.folder.rename(self._aside)
            # What replaces a private log is private.
            self.folder.mkdir(0o777 if self.config.mode is None else self.config.mode | 0o700, parents=True)
        except FileExistsError:
            self._put_back()
            raise Taken(f"a recording to {self.config.log} has just begun") from None
        except OSError as error:
            self._put_back()
            raise UsageError(f"cannot write {self.folder}: {error.strerror}") from None
        try:
            self.config.save(self.folder)
            self._lock = Lock(self.folder, RUNNING, shared=True)
            self._control = Store(SpoolWriter(self.folder, CONTROL), ignore)
            self._note_event(
                "begin", host=platform.node(), version=__version__, system=f"{platform.system()} {platform.release()}"
            )
            for child in self._readers.values():
                child.start()
            self._await_open()
            self._remove_replaced()
            self._decoder.start()
        except OSError as error:
            self._abandon()
            raise UsageError(f"cannot write {self.folder}: {error.strerror or error}") from None
        except BaseException:
            self._abandon()
            raise
        self.began_ns = time.monotonic_ns()
        self.phase = "recording"

    def _await_open(self) -> None:
        until = time.monotonic() + OPEN_S
        waiting = set(self._readers)
        while waiting and not self._stopping.is_set():
            try:
                kind, name, what = self._heard.get(timeout=max(0.0, until - time.monotonic()))
            except queue.Empty:
                buses = ", ".join(self.tallies[name].endpoint for name in sorted(waiting))
                raise UsageError(f"{buses} did not open within {OPEN_S:.0f} s") from None
            if kind == "event" and what.get("event") == "failed":
                raise UsageError(f"{self.tallies[name].endpoint}: {what['reason']}")
            if kind == "exit":
                raise ServotapError(f"{self.tallies[name].endpoint}: the reader process ended: {self._words(name, what)}")
            if kind == "event":
                self._hear_event(name, what)
                if what.get("event") == "open":
                    waiting.discard(name)

    def _put_back(self) -> None:
        """Give older spools their name again."""
        if self._aside.exists():
            self._aside.rename(self.folder)

    def _remove_replaced(self) -> None:
        if self._aside.exists():
            shutil.rmtree(self._aside)
        for path in self._replaces:
            if path.is_file():
                path.unlink()

    def _words(self, name: str, status: int) -> str:
        return self._readers[name].died(status)

    def _abandon(self) -> None:
        """Leave nothing behind of a recording that did not begin."""
        for child in self._readers.values():
            child.kill()
        for child in self._readers.values():
            child.wait(END_S)
            child.close()
        shutil.rmtree(self.folder, ignore_errors=True)
        self._put_back()
        self.phase = "over"

    def run(self) -> None:
        """Record until `stop`, or for the duration; then end in order."""
        wall = clock.WallClock(clock.now())
        looked_ns = time.monotonic_ns()
        try:
            while not self._stopping.is_set():
                left_ns = self.began_ns + self._duration_ns - time.monotonic_ns() if self._duration_ns else SECOND_NS
                self._turn(min(_TURN_S, max(0, left_ns) / SECOND_NS))
                now_ns = time.monotonic_ns()
                if self._duration_ns and now_ns - self.began_ns >= self._duration_ns:
                    self.stop("the duration is over")
                if now_ns - looked_ns >= SECOND_NS:
                    looked_ns = now_ns
                    self._keep_config()
                    for change in wall.look(clock.now()):
                        self._note_event(change.event, **change.about)
                        if change.event == "clock_step":
                            seconds = int(change.about["step_ns"]) / 1e9
                            self._on_note("", f"{change.about['cause']} ({seconds:+.3f} s); times in the log do not follow")
        finally:
            self._end()

    def _keep_config(self) -> None:
        """Write the configuration again where it was deleted: without it nothing can read the spools."""
        if self.folder.is_dir() and not all((self.folder / name).exists() for name in FILES):
            # On a full disk, the next time.
            with contextlib.suppress(OSError):
                self.config.save(self.folder)

    def _turn(self, seconds: float) -> str:
        """Wait for something to happen, take it and return what; start what is due."""
        try:
            kind, name, what = self._heard.get(timeout=seconds)
        except queue.Empty:
            kind, name, what = "", "", None
        if kind == "event":
            self._hear_event(name, what)
        elif kind == "snapshot":
            self.snapshot = what
            self._on_snapshot(what)
        elif kind == "said":
            self._on_note(self.tallies[name].bus if name in self.tallies else "", what)
        elif kind == "exit":
            self._hear_exit(name, what)
        now = time.monotonic()
        for child in (*self._readers.values(), self._decoder):
            if child.due is not None and child.due <= now:
                self._keep_config()
                try:
                    child.start()
                    if child is self._decoder and self.phase == "finishing":
                        child.drop_leash()
                except OSError as error:
                    # Out of memory or of processes: perhaps not for long.
                    child.died(1)
                    self._deaths += self.phase == "finishing"
                    self._on_note("", f"cannot start a process: {error.strerror or error}; retrying")
        return kind

    def _hear_event(self, name: str, event: Mapping[str, Any]) -> None:
        port = self.tallies[name]
        text = take(port, event)
        if text:
            self._on_note(port.bus, text)

    def _hear_exit(self, name: str, status: int) -> None:
        """Take the death of a process, the last that is heard of it: it is restarted, unless it had been asked to end."""
        reader = name in self._readers
        if reader and self.phase in ("ending", "finishing"):
            # One that had to be killed is heard of later.
            self._gone.add(name)
            return
        if not reader and self.phase == "finishing":
            self._decoded = status == WHOLE
            if self._decoded or self._given_up:
                return
            if self._decoder.last_words().startswith(SAYS):
                # It has given up, and said why; that is no accident.
                self.unfinished = self._decoder.last_words().removeprefix(SAYS)
                self._given_up = True
                return
            self._deaths += 1
        child = self._readers[name] if reader else self._decoder
        reason = child.died(status)
        bus = self.tallies[name].bus if reader else ""
        what = "reader" if reader else "decoding"
        if reader:
            self.tallies[name].restarts += 1
        else:
            self.decoder_restarts += 1
        self._note_event("restarted", what=what, stem=name if reader else "", reason=reason)
        again = "it is restarted" + ("" if reader else "; no data was lost, the readers continue")
        self._on_note(bus, f"the {what} process ended ({reason}); {again}")

    def _note_event(self, event: str, **about: Any) -> None:
        """Write an event of the recording."""
        with self._control_lock:
            if self._control is not None:
                self._control.event(event, **about)

    # --- the end --------------------------------------------------------------------------------------------------

    def _end(self) -> None:
        self.phase = "ending"
        self.ended_ns = time.monotonic_ns()
        for name, child in self._readers.items():
            if child.due is not None:
                # It has died and is not started again.
                self._gone.add(name)
            child.end()
        until = time.monotonic() + END_S
        while self._gone < self._readers.keys() and time.monotonic() < until:
            self._turn(0.05)
        for name in self._readers.keys() - self._gone:
            self._on_note(self.tallies[name].bus, f"the reader process did not end within {END_S:.0f} s and was killed")
            self._readers[name].kill()
            self._readers[name].wait(1.0)
        for port in self.tallies.values():
            if port.state == "listening":
                self._lose(port)
        self._finish()
        for child in (*self._readers.values(), self._decoder):
            child.close()
        if self._lock is not None:
            self._lock.close()
        self.phase = "over"

    def _lose(self, port: PortStatus) -> None:
        """Note that the reader of a port has not told its end: what it held is lost."""
        reason = "its reader process died and did not tell its end"
        take(port, {"event": "lost", "t_ns": self.ended_ns, "reason": reason})
        self._note_event("lost", reason=f"{port.bus}: {reason}")
        self._on_note(port.bus, f"{reason}: what it held is lost")

    def _finish(self) -> None:
        """Say the end, and wait for the decoding process to have finished the log."""
        self.phase = "finishing"
        self._note_event("end", reason=self.reason)
        with self._control_lock:
            assert self._control is not None
            self._control.finish()
            self._control = None
        # While it cannot write it reads nothing, and so no `end`: it is told as the death of a supervisor is, too.
        self._decoder.drop_leash()
        heard = time.monotonic()
        while not self._decoded and self._deaths < LAST_DEATHS:
            if self._turn(_TURN_S) or self._decoder.due is not None:
                heard = time.monotonic()
            if self._given_up or time.monotonic() - heard > SILENT_S:
                self._decoder.kill()
                self._decoder.wait(1.0)
                break
        if not self._decoded and not self.unfinished:
            self.unfinished = f"the log is incomplete; servotap recover {self.config.log} finishes it"
