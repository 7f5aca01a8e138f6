"""The loop of a tap: bytes from the program to the adapter and back, as soon as they are there.

    poll -> read the adapter -> write to the program -> read the program -> write to the adapter -> store

It hands bytes to `Storing`, and knows no spools or processes. A thread reopens a lost adapter, since a connection may take
seconds.
"""

from __future__ import annotations

import os
import select
import threading
import time
from collections.abc import Callable

from analyzer.live.reader_port import IDLE_NS, TICK_NS, Lost, Opened, Stop, Unopened
from analyzer.live.reader_serial import counters
from analyzer.values import counted
from conformance.tap.adapter import Adapter
from conformance.tap.settings import LineSettings, of_terminal, unsent
from conformance.tap.storing import REPLY, REQUEST, SendQueue, Storing
from conformance.tap.terminal import Terminal

READ_SIZE = 1 << 16
#: Reads of the adapter in a row before the program gets its turn.
_READS = 16
#: How often a port that nothing passes through is looked at for a new speed, in ms.
LOOK_MS = 20
#: What waits for a program that does not read.
PROGRAM_LIMIT = 1 << 20
#: What is taken from the program at a time. An adapter that takes bytes at all takes so many, so that none wait here.
#: Bytes that wait are lost where this process is killed.
ADAPTER_LIMIT = 1 << 8
#: How long a change of speed waits for what was written before to be sent.
_SENT_WITHIN_NS = 2_000_000_000
#: At the end: how long is looked for what the program had written, and for each next piece of it.
_LEFT_WITHIN_S, _NEXT_PIECE_MS = 1.0, 20
FIRST_RETRY_S = 0.1
LAST_RETRY_S = 2.0


class Passing:
    """Passes bytes until the end is wished. `named`: the settings that the endpoint names."""

    def __init__(
        self, terminal: Terminal, adapter: Adapter, storing: Storing, stop: Stop, named: LineSettings,
        *, keep_on: Callable[[], bool] = lambda: False,
    ) -> None:  # fmt: skip
        self._terminal = terminal
        self._adapter = adapter
        self._storing = storing
        self._stop = stop
        #: Asked when the end is wished: whether to go on nevertheless while a program has the port open.
        self._keep_on = keep_on
        self._named = named
        self.settings = named
        self._refused: LineSettings | None = None
        self._deferred_ns = 0
        self._sent = SendQueue()
        self._to_adapter = bytearray()
        #: Whether the adapter takes nothing at present; then the program's writes wait, too.
        self._blocked = False
        self._to_program = bytearray()
        self._quiet_since = dict.fromkeys((REQUEST, REPLY), time.monotonic_ns())
        self._quiet_told = dict.fromkeys((REQUEST, REPLY), False)
        #: Goes on although the end is wished.
        self._alone = False
        #: Bytes that did not reach the program, and of the program that were not sent; since they were last told.
        self._unread = self._unsent = 0
        self._poll = select.poll()
        self._masks: dict[int, int] = {}
        self._opener: _Opener | None = None
        self._lost_ns = 0
        self._counters = counters(adapter.fd) if adapter.has_line else None
        self._counted_ns = self._tick_ns = time.monotonic_ns()
        #: Called with the direction and the number of bytes that were taken.
        self.on_taken: Callable[[str, int], None] = lambda direction, size: None
        #: Called with the descriptor of each adapter that was opened again.
        self.on_open: Callable[[int], None] = lambda fd: None

    @property
    def _byte_ns(self) -> int:
        return self.settings.byte_ns if self._adapter.has_line else self._adapter.endpoint.byte_ns

    # --- the loop -------------------------------------------------------------------------------------------------

    def run(self) -> None:
        """Pass bytes on until the end is wished."""
        terminal, stop = self._terminal, self._stop
        self._watch(stop.fileno(), select.POLLIN)
        if terminal.watch is not None:
            self._watch(terminal.watch, select.POLLIN)
        self._follow()
        while not self._ended():
            self._arrange()
            ready = dict(self._poll.poll(self._wait_ms()))
            if terminal.watch is not None and terminal.watch in ready and terminal.look():
                self._to_program.clear()
            fd, master = self._fd, ready.get(terminal.master, 0)
            if ready.get(fd, 0) & (select.POLLIN | select.POLLHUP | select.POLLERR):
                self._read_adapter()
            if self._to_program and master & select.POLLOUT:
                self._write_program()
            self._follow()
            if master & select.POLLIN and not self._deferred_ns:
                self._read_program()
            elif ready.get(fd, 0) & select.POLLOUT:
                self._blocked = False
                if self._to_adapter:
                    self._write_adapter(b"")
            self._after()
        self._finish()

    def _ended(self) -> bool:
        if not self._stop.asked:
            return False
        if self._keep_on() and self._terminal.attended:
            self._alone = True
            # Its descriptor is readable from now on, and there is nothing more to hear from it.
            self._watch(self._stop.fileno(), 0)
            return False
        return True

    @property
    def _fd(self) -> int:
        """The adapter's descriptor; -1 while it is gone, also when a thread has just opened it."""
        return self._adapter.fd if self._opener is None else -1

    def _arrange(self) -> None:
        """Say what is waited for."""
        fd = self._fd
        if fd >= 0:
            self._watch(fd, select.POLLIN | (select.POLLOUT if self._to_adapter or self._blocked else 0))
        full = self._to_adapter or self._blocked or self._deferred_ns
        out = select.POLLOUT if self._to_program else 0
        self._watch(self._terminal.master, (0 if full else select.POLLIN) | out)

    def _watch(self, fd: int, mask: int) -> None:
        if self._masks.get(fd, 0) != mask:
            if mask:
                self._poll.register(fd, mask)
            else:
                self._poll.unregister(fd)
            self._masks[fd] = mask

    def _wait_ms(self) -> int:
        if self._deferred_ns:
            return 1
        next_ns = self._sent.next_ns
        if next_ns is None:
            return LOOK_MS
        return max(0, min(LOOK_MS, (next_ns - time.monotonic_ns()) // 1_000_000 + 1))

    # --- adapter to program ---------------------------------------------------------------------------------------

    def _read_adapter(self) -> None:
        fd = self._adapter.fd
        pieces = []
        gone: str | None = None
        for _ in range(_READS):
            try:
                data = os.read(fd, READ_SIZE)
            except BlockingIOError:
                break
            except OSError as error:
                gone = error.strerror or str(error)
                break
            if not data:
                gone = "the port disconnected (unplugged?)" if self._adapter.has_line else "the server closed the connection"
                break
            stamp_ns = time.monotonic_ns()
            self.on_taken(REPLY, len(data))
            self._give_program(data)
            pieces.append((stamp_ns, data))
        if pieces:
            byte_ns = self._byte_ns
            stamp_ns, data = pieces[0]
            done = self._sent.answered(stamp_ns - len(data) * byte_ns)
            if done:
                self._store(REQUEST, done)
            self._store(REPLY, pieces)
        if gone is not None:
            self._lose(gone)

    def _give_program(self, data: bytes) -> None:
        if not self._terminal.attended:
            # No program has the port open: the bytes are lost, as on a real port.
            return
        room = PROGRAM_LIMIT - len(self._to_program)
        if len(data) > room:
            self._unread += len(data) - room
            data = data[:room]
        if self._to_program:
            self._to_program += data
            return
        written = self._write_master(data)
        if written < len(data):
            self._to_program += data[written:]

    def _write_program(self) -> None:
        written = self._write_master(self._to_program)
        del self._to_program[:written]

    def _write_master(self, data: bytes | bytearray) -> int:
        try:
            return os.write(self._terminal.master, data)
        except OSError:
            # Full: retrying when there is room.
            return 0

    # --- program to adapter ---------------------------------------------------------------------------------------

    def _read_program(self) -> None:
        fd = self._fd
        self._blocked = fd >= 0 and not _writable(fd)
        if self._blocked:
            return
        try:
            data = os.read(self._terminal.master, ADAPTER_LIMIT)
        except OSError:
            return
        self._write_adapter(data)

    def _write_adapter(self, data: bytes) -> None:
        fd = self._fd
        if fd < 0:
            self._unsent += len(data)
            return
        if self._to_adapter:
            self._to_adapter += data
            data = bytes(self._to_adapter)
        # Before: who waits for the bytes is woken by the write, and often runs before this process does again.
        now_ns = time.monotonic_ns()
        try:
            written = os.write(fd, data)
        except BlockingIOError:
            written = 0
        except OSError as error:
            self._to_adapter[:] = data
            self._lose(error.strerror or str(error))
            return
        self._to_adapter[:] = data[written:]
        if written:
            self.on_taken(REQUEST, written)
            self._sent.add(now_ns, data[:written], self._byte_ns)

    # --- settings -------------------------------------------------------------------------------------------------

    def _follow(self) -> None:
        """Set the adapter as the program has set its port, once what was written before has been sent."""
        adapter = self._adapter
        wanted = of_terminal(self._terminal.slave, self._named)
        if not adapter.has_line or wanted in (self.settings, self._refused):
            self._deferred_ns = 0
            return
        now_ns = time.monotonic_ns()
        if self._fd >= 0:
            self._deferred_ns = self._deferred_ns or now_ns
            waiting = bool(self._to_adapter) or unsent(adapter.fd) > 0
            if waiting and now_ns - self._deferred_ns < _SENT_WITHIN_NS:
                return
            try:
                adapter.set(wanted)
            except OSError as error:
                self._refused = wanted
                self._deferred_ns = 0
                reason = error.strerror or str(error)
                self._storing.event(REPLY, "note", text=f"the adapter does not take {wanted} ({reason}); it stays as it was")
                return
        # What waits was sent at the speed before.
        self._store(REQUEST, self._sent.answered(now_ns))
        self.settings, self._refused, self._deferred_ns = wanted, None, 0
        about = {"speed": wanted.speed, "byte_ns": wanted.byte_ns, "text": f"the program set the line to {wanted}"}
        self._storing.event(REPLY, "speed", now_ns, **about)

    # --- an adapter that comes and goes ---------------------------------------------------------------------------

    def _lose(self, reason: str) -> None:
        self._watch(self._adapter.fd, 0)
        self._lost_ns = now_ns = time.monotonic_ns()
        self._store(REQUEST, self._sent.answered(now_ns))
        self._unsent += len(self._to_adapter)
        self._to_adapter.clear()
        self._blocked = False
        self._adapter.close()
        self._storing.event(REPLY, "lost", now_ns, reason=reason)
        self._opener = _Opener(self._adapter, self._stop, self.settings)

    def _take_back(self) -> None:
        """Take the adapter up again when it is open."""
        opener = self._opener
        if opener is None:
            return
        for text in opener.said():
            self._storing.event(REPLY, "note", text=text)
        if opener.opened is None:
            return
        # While the reason is known.
        self._tell_losses()
        self._opener = None
        now_ns = time.monotonic_ns()
        # Another speed may have been set meanwhile; the terminal is looked at next.
        self.settings = opener.settings
        about = {"notes": list(opener.opened.notes), "precision": opener.opened.precision, "reason": ""}
        self._storing.event(REPLY, "back", now_ns, gap_ns=now_ns - self._lost_ns, from_ns=self._lost_ns, **about)
        self._counters = counters(self._adapter.fd) if self._adapter.has_line else None
        self.on_open(self._adapter.fd)

    # --- storing --------------------------------------------------------------------------------------------------

    def _store(self, direction: str, pieces: list[tuple[int, bytes]]) -> None:
        if pieces:
            self._storing.pieces(direction, pieces, self._byte_ns)
            self._quiet_since[direction] = pieces[-1][0]
            self._quiet_told[direction] = False

    def _after(self) -> None:
        """Do what is due: all of it can wait for the bytes."""
        now_ns = time.monotonic_ns()
        self._store(REQUEST, self._sent.ended(now_ns))
        self._take_back()
        idle_after_ns = IDLE_NS + 2 * self._byte_ns
        for direction, since_ns in self._quiet_since.items():
            sending = direction == REQUEST and self._sent.next_ns is not None
            if not self._quiet_told[direction] and not sending and now_ns - since_ns >= idle_after_ns:
                self._quiet_told[direction] = True
                self._storing.quiet(direction, now_ns)
        if now_ns - self._tick_ns >= TICK_NS:
            self._tick_ns = now_ns
            self._tick(now_ns)

    def _tick(self, now_ns: int) -> None:
        self._tell_losses()
        self._storing.flush()
        if self._alone and self._quiet_told[REPLY]:
            self._storing.still_there(now_ns)
        before, since_ns = self._counters, self._counted_ns
        if before is None or self._fd < 0:
            return
        self._counters, self._counted_ns = counters(self._adapter.fd), now_ns
        risen = {name: n - before[name] for name, n in (self._counters or {}).items() if n > before[name]}
        if risen:
            self._storing.event(REPLY, "overrun", from_ns=since_ns, **risen)

    def _tell_losses(self) -> None:
        if self._unread:
            text = f"the program did not read: {self._unread} bytes of replies did not reach it (they are recorded)"
            self._storing.event(REPLY, "note", text=text)
            self._unread = 0
        if self._unsent:
            took_no_more = self._blocked or self._to_adapter
            why = (
                "the adapter was gone" if self._fd < 0 else "the adapter took no more" if took_no_more else "the tap was ending"
            )
            text = f"{counted(self._unsent, 'byte')} that the program wrote were not sent: {why}"
            self._storing.event(REPLY, "note", text=text)
            self._unsent = 0

    def _left_by_program(self) -> int:
        """Take what the program has written and the adapter did not get; return how much it was."""
        poll, size, until = select.poll(), 0, time.monotonic() + _LEFT_WITHIN_S
        poll.register(self._terminal.master, select.POLLIN)
        # The kernel gives it in pieces, each a little after the one before was taken.
        while time.monotonic() < until and any(mask & select.POLLIN for _, mask in poll.poll(_NEXT_PIECE_MS)):
            try:
                size += len(os.read(self._terminal.master, READ_SIZE))
            except OSError:
                break
        return size

    def _finish(self) -> None:
        """Take what has come, and give everything on that can be given at once."""
        if self._fd >= 0:
            self._read_adapter()
        if self._opener is not None:
            self._opener.give_up()
        if self._to_adapter:
            self._write_adapter(b"")
        self._unsent += len(self._to_adapter) + self._left_by_program()
        self._store(REQUEST, self._sent.answered(time.monotonic_ns()))
        self._tell_losses()


def _writable(fd: int) -> bool:
    """Say whether a descriptor takes bytes at present."""
    poll = select.poll()
    poll.register(fd, select.POLLOUT)
    return bool(poll.poll(0))


class _Opener:
    """Opens an adapter again, in a thread of its own. `opened`: set when it is open."""

    def __init__(self, adapter: Adapter, stop: Stop, settings: LineSettings) -> None:
        self._adapter = adapter
        self._stop = stop
        self.settings = settings
        self.opened: Opened | None = None
        self._texts: list[str] = []
        self._last = ""
        self._given_up = threading.Event()
        self._thread = threading.Thread(target=self._run, name="servotap-open", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        wait_s = FIRST_RETRY_S
        while not self._given_up.wait(wait_s):
            try:
                self.opened = self._adapter.open(self._stop, self.settings)
                return
            except Unopened as error:
                if str(error) != self._last:
                    self._last = str(error)
                    self._texts.append(self._last)
            except Lost:
                return
            wait_s = min(2 * wait_s, LAST_RETRY_S)

    def said(self) -> list[str]:
        """Return why it could not be opened, each reason once."""
        texts, self._texts = self._texts, []
        return texts

    def give_up(self) -> None:
        """Try no more."""
        self._given_up.set()
        self._thread.join(1.0)
