"""The processes of a recording, as the supervisor sees them: started, heard, restarted, ended.

Each child is a session of its own, so a terminal's Ctrl-C and hang-up reach the supervisor alone. Its standard input is a
pipe from the supervisor, the *leash*: the child ends by itself when the supervisor's end closes.

What a child says (events of a reader, snapshots of the decoding process) is put into the supervisor's queue by a thread.
"""

from __future__ import annotations

import contextlib
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any

import msgspec

from analyzer.live import snapshot
from analyzer.live.reader_hand import Hand
from analyzer.live.snapshot import Snapshot
from analyzer.system.decoding import UNDECODABLE

#: A child that lived this long is started again at once when it dies; one that did not, after a while that grows.
STEADY_S = 10.0
FIRST_WAIT_S = 0.1
LAST_WAIT_S = 5.0
#: Lines of a child's standard error that are kept, to say why it died.
_LAST_WORDS = 20
#: How a line on standard error begins that is for people.
SAYS = "servotap record: "
_LEFT_OUT = "servotap: "
#: Numbers of segments for each start of a reader: none is used twice, even after older ones were deleted.
SEGMENTS = 1_000_000
#: Readers go before everything else where that is allowed (root); elsewhere decoding goes after them.
READER_NICE = -10
DECODER_NICE = 5

_UNIX = os.name == "posix"
#: So that nothing in the folder where the user happens to be is taken for a module.
PYTHON = [sys.executable, "-P"]

MessageQueue = queue.SimpleQueue[tuple[str, Any, Any]]


class Child(ABC):
    """One process that is started again when it dies. `name`: the stem of a reader, or `decoding`.

    `handed`: descriptors that it and its successors inherit, which stay the caller's. It puts into `heard`: ("event", name,
    object), ("snapshot", name, Snapshot), ("said", name, text), ("exit", name, status), which is the last of all.
    """

    #: Told where its segments begin, as one that stores.
    stores = False

    def __init__(self, name: str, command: Sequence[str], heard: MessageQueue, nice: int, handed: Sequence[int] = ()) -> None:
        self.name = name
        self._command = list(command)
        self._heard = heard
        self._nice = nice
        self._handed = tuple(handed)
        self._process: subprocess.Popen[bytes] | None = None
        self._leash: socket.socket | IO[bytes] | None = None
        self._words: deque[str] = deque(maxlen=_LAST_WORDS)
        self._kept: int | None = None
        self._lock = threading.Lock()
        self._started = 0.0
        self._wait_s = 0.0
        #: Whether anything was heard of it since it was started.
        self._spoke = False
        #: When it is to be started again, on `time.monotonic`; None while it runs or is not to.
        self.due: float | None = None
        self.restarts = 0

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    @property
    def pid(self) -> int:
        """Its process id, 0 before it was started."""
        return 0 if self._process is None else self._process.pid

    def start(self) -> None:
        """Start it, with what is kept of its forerunner."""
        with self._lock:
            kept = self._kept
        words = list(self._command)
        handed = self._handed
        if kept is not None:
            words += ["--adopt", str(kept)]
            handed += (kept,)
        if self.stores and self.restarts:
            words += ["--first-segment", str(self.restarts * SEGMENTS)]
        self.drop_leash()
        self._words.clear()
        # A socket, for descriptors come back on it; elsewhere than on Unix a pipe.
        ours, theirs = socket.socketpair() if _UNIX else (None, None)
        self._process = process = subprocess.Popen(
            words,
            stdin=theirs.fileno() if theirs is not None else subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=handed,
            start_new_session=True,
            creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
            env=_environment(),
        )
        if theirs is not None:
            theirs.close()
        self._leash = ours if ours is not None else process.stdin
        self._started = time.monotonic()
        self._spoke = False
        self.due = None
        if _UNIX and self._nice:
            _set_nice(process.pid, self._nice)
        assert process.stderr is not None
        errors = threading.Thread(target=self._read_words, args=(process.stderr,), daemon=True)
        errors.start()
        threading.Thread(target=self._listen, args=(process, errors), daemon=True).start()
        if ours is not None and hasattr(socket, "recv_fds"):
            threading.Thread(target=self._keep, args=(ours,), daemon=True).start()

    def _listen(self, process: subprocess.Popen[bytes], errors: threading.Thread) -> None:
        assert process.stdout is not None
        with process.stdout as stream:
            for line in stream:
                self._spoke = True
                self._hear(line)
        status = process.wait()
        errors.join(1.0)
        self._heard.put(("exit", self.name, status))

    @abstractmethod
    def _hear(self, line: bytes) -> None:
        """Take a line that the process said on its standard output."""

    def _read_words(self, stream: IO[bytes]) -> None:
        with stream:
            for line in stream:
                text = line.decode(errors="replace").rstrip()
                # For people, also of a package that was left out; all else is what a program leaves that breaks down.
                said = next((text.removeprefix(begin) for begin in (SAYS, _LEFT_OUT) if text.startswith(begin)), None)
                if said is not None:
                    self._heard.put(("said", self.name, said))
                self._words.append(text)

    def _keep(self, leash: socket.socket) -> None:
        """Keep what a reader hands over: a second hold on its port."""
        while True:
            try:
                _, descriptors, _, _ = socket.recv_fds(leash, 16, 4)
            except OSError:
                return
            if not descriptors:
                return
            self.let_go()
            with self._lock:
                self._kept = descriptors[0]

    def let_go(self) -> None:
        """Give up what is kept: the port is gone, and can only come back when no process holds it."""
        with self._lock:
            kept, self._kept = self._kept, None
        if kept is not None:
            os.close(kept)

    def last_words(self) -> str:
        """Return the last line of its standard error, or nothing."""
        return self._words[-1] if self._words else ""

    def died(self, status: int) -> str:
        """Take note of its death; return why, in words. It is due again after a while that grows."""
        lived = time.monotonic() - self._started
        if lived >= STEADY_S:
            self._wait_s = 0.0
        self.due = time.monotonic() + self._wait_s
        self._wait_s = min(max(self._wait_s * 2, FIRST_WAIT_S), LAST_WAIT_S)
        if not self._spoke:
            # Perhaps what was handed over is what it dies of.
            self.let_go()
        self.restarts += 1
        return _why(status, self.last_words())

    def end(self) -> None:
        """Ask it to end."""
        self.due = None
        if self._process is not None and self._process.poll() is None:
            if _UNIX:
                self._process.terminate()
            else:
                # Elsewhere that would end it at once, with what it still holds.
                self.drop_leash()

    def kill(self) -> None:
        self.due = None
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def wait(self, seconds: float) -> bool:
        """Wait for its end; say whether it came."""
        if self._process is None:
            return True
        try:
            self._process.wait(seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        self.drop_leash()
        self.let_go()

    def drop_leash(self) -> None:
        """Close the leash: the child ends as if the supervisor had died."""
        leash, self._leash = self._leash, None
        if leash is not None:
            # Closing alone would not end a wait for descriptors in another thread.
            with contextlib.suppress(OSError):
                if isinstance(leash, socket.socket):
                    leash.shutdown(socket.SHUT_RDWR)
                leash.close()


class StoringChild(Child):
    """A process that stores, and tells events as lines of JSON. Those of one that stores several spools name theirs."""

    stores = True

    def _hear(self, line: bytes) -> None:
        try:
            event = msgspec.json.decode(line, type=dict[str, Any])
        except UNDECODABLE:
            return
        if event.get("event") == "lost":
            self.let_go()
        self._heard.put(("event", event.pop("stem", self.name), event))


class ReaderChild(StoringChild):
    """The reader process of one port."""

    def __init__(self, folder: Path, stem: str, heard: MessageQueue, *, plain: bool = False) -> None:
        command = [*PYTHON, "-m", "analyzer.live.reader", str(folder), stem]
        self._hand = Hand.make()
        handed = [] if self._hand is None else [self._hand]
        command += [*(["--plain"] * plain), *(f"--hand={fd}" for fd in handed)]
        super().__init__(stem, command, heard, READER_NICE, handed)

    def close(self) -> None:
        super().close()
        hand, self._hand = self._hand, None
        if hand is not None:
            os.close(hand)


class DecoderChild(Child):
    """The decoding process: it follows the spools and writes the log."""

    def __init__(self, folder: Path, heard: MessageQueue) -> None:
        command = [*PYTHON, "-m", "analyzer.live.recorder", str(folder), "--feed", "1"]
        nice = 0 if _UNIX and os.geteuid() == 0 else DECODER_NICE
        super().__init__("decoding", command, heard, nice)

    def _hear(self, line: bytes) -> None:
        try:
            found: Snapshot = snapshot.decode(line)
        except UNDECODABLE:
            return
        self._heard.put(("snapshot", self.name, found))


def _environment() -> dict[str, str]:
    """Return the environment of a child: as ours, and a checkout that was never installed finds itself."""
    environment = dict(os.environ)
    root = Path(__file__).parents[2]
    if (root / "pyproject.toml").exists():
        environment["PYTHONPATH"] = os.pathsep.join(p for p in (str(root), environment.get("PYTHONPATH")) if p)
    return environment


def _set_nice(pid: int, nice: int) -> None:
    """Let a process go before others, or after them: a wish, most users may only lower it."""
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, pid, os.getpriority(os.PRIO_PROCESS, 0) + nice)
    # Where Linux weighs sessions against each other, that counts within a session alone.
    with contextlib.suppress(OSError), open(f"/proc/{pid}/autogroup", "wb", buffering=0) as group:
        group.write(str(nice).encode())


def _why(status: int, words: str) -> str:
    if status < 0:
        try:
            text = f"killed by {signal.Signals(-status).name}"
        except ValueError:
            text = f"killed by signal {-status}"
    else:
        text = f"exit status {status}"
    return f"{text}: {words}" if words else text
