"""The echo of a line: some adapters return the bytes that they send. This removes them, and keeps a drive's own echo.

    sent 3E 80 01 00 BF    heard 3E 80 01 00 BF 3E 80 01 00 BF    the first is the adapter's, the second the drive's reply

Rules that separate the two. An adapter always echoes or never does, and its echo comes first:

1. If no reply of the catalogue can equal the request (most have another head or length), a copy is the adapter's.
2. If one can (LK 80h, 81h, 88h; Modbus 06h), the copy is the adapter's if rule 1 showed that the adapter echoes. If that is
   unknown, the first of two copies is the adapter's.
3. After `FIRM` equal sendings in a row the answer is final. From then on a drive that wrongly echoes a read is heard.

A copy must come within `WAIT_NS` after the end of the sending; part of a copy is held back for that time only. A damaged
echo is passed on: it shows a collision.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from functools import lru_cache

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Role
from analyzer.records import Chunk

#: How long an echo may take behind the end of the sending: an adapter's latency timer, a busy host.
WAIT_NS = 60_000_000
#: Sendings in a row that settle whether an adapter echoes.
FIRM = 3
#: The most sendings that are waited for at once.
_MOST = 64


class EchoFilter:
    """Takes a line's own bytes out of what is heard. `echoes`: what is known of the adapter, None: nothing yet."""

    def __init__(self) -> None:
        self.echoes: bool | None = None
        self.dropped = 0
        self._evidence = 0
        self._sent: deque[tuple[int, bytes]] = deque(maxlen=_MOST)
        self._held = b""
        self._held_ns = 0
        #: A copy that was passed on and may have been an echo, should another one follow.
        self._passed: bytes | None = None

    @property
    def firm(self) -> bool:
        """Whether what is known holds for good."""
        return abs(self._evidence) >= FIRM

    @property
    def holds(self) -> bool:
        """Whether bytes are held back that may be the beginning of an echo."""
        return bool(self._held)

    def sent(self, data: bytes, end_ns: int) -> None:
        """Take it that bytes leave, the last of them at `end_ns`."""
        self._passed = None
        if self.firm and not self.echoes:
            return
        self._sent.append((end_ns + WAIT_NS, data))

    def reset(self) -> None:
        """Forget what was sent; what is known of the adapter stays."""
        self._sent.clear()
        self._held, self._passed = b"", None

    def heard(self, chunk: Chunk) -> list[Chunk]:
        """Return what of a chunk did not come from this host."""
        t_ns = chunk.t_ns or 0
        data, self._held = self._held + chunk.data, b""
        passed: list[bytes] = []
        while data:
            while self._sent and self._sent[0][0] < t_ns:
                self._sent.popleft()
            if not self._sent:
                passed.append(self._second(data, t_ns))
                break
            own = self._sent[0][1]
            found = data.find(own)
            if found >= 0:
                passed.append(data[:found])
                data = data[found + len(own) :]
                if self._is_echo(own, data):
                    self.dropped += 1
                else:
                    passed.append(own)
                continue
            # An echo comes first: behind other bytes its beginning is waited for only where echoes are known to come.
            kept = _overlap(data, own) if self.echoes else len(data) * own.startswith(data)
            passed.append(data[: len(data) - kept])
            self._held, self._held_ns = data[len(data) - kept :], t_ns
            if passed[-1] and not kept:
                self._answered()
            break
        out = b"".join(passed)
        return [Chunk(chunk.t_ns, chunk.port, out, chunk.direction, chunk.burst)] if out else []

    def late(self, now_ns: int) -> bytes:
        """Return what was held back for too long, to be passed on."""
        if not self._held or now_ns - self._held_ns < WAIT_NS:
            return b""
        held, self._held, self._passed = self._held, b"", None
        if self._sent:
            self._sent.popleft()
        return held

    # --- what is learnt -------------------------------------------------------------------------------------------

    def _is_echo(self, own: bytes, behind: bytes) -> bool:
        """Judge a copy of what was sent."""
        self._sent.popleft()
        if not could_be_reply(own):
            if self.firm:
                return bool(self.echoes)
            self._learn(True)
            return True
        if self.echoes is not None:
            return self.echoes
        if behind.startswith(own):
            self.echoes = True
            return True
        # It may be a reply, or an echo whose reply is still to come: then that one is left out instead.
        self._passed = own
        return False

    def _second(self, data: bytes, t_ns: int) -> bytes:
        """Return what is passed on of bytes for which nothing is awaited, but perhaps a second copy."""
        passed, self._passed = self._passed, None
        if passed is None or self.echoes is not None:
            return data
        if data.startswith(passed):
            self.echoes = True
            self.dropped += 1
            return data[len(passed) :]
        if passed.startswith(data):
            self._passed, self._held, self._held_ns = passed, data, t_ns
            return b""
        return data

    def _answered(self) -> None:
        """Take it that something else came than an echo."""
        own = self._sent.popleft()[1]
        if not self.firm and not could_be_reply(own):
            self._learn(False)

    def _learn(self, echoes: bool) -> None:
        step = 1 if echoes else -1
        self._evidence = self._evidence + step if self._evidence * step >= 0 else step
        self.echoes = echoes
        if self.firm and not echoes:
            self._sent.clear()


def _overlap(data: bytes, own: bytes) -> int:
    """Return how many bytes at the end of `data` are the beginning of `own`."""
    for size in range(min(len(data), len(own) - 1), 0, -1):
        if own.startswith(data[-size:]):
            return size
    return 0


@lru_cache(maxsize=1024)
def could_be_reply(frame: bytes) -> bool:
    """Say whether a drive may answer these bytes with the same bytes; also where the bytes are unknown."""
    read = [answer for d in _serial() if (answer := _echoed(d, frame)) is not None]
    return any(read) if read else True


def _echoed(dialect: Dialect, frame: bytes) -> bool | None:
    """Say whether a request of one dialect can be answered with itself; None where it is no request of it."""
    if len(frame) < 4 or not dialect.link.fits(frame):
        return None
    head = dialect.link.parse(frame)
    if head.role is Role.REPLY:
        return None
    same = [c for c in dialect.commands if c.code == head.code and c.function == head.function]
    if not same:
        return None
    if head.role is Role.REQUEST:
        # The head or the length of a reply is another one.
        return False
    size = head.stop - head.start
    return any(f.layout.fits(size) for c in same for f in c.reply_forms)


def _serial() -> Sequence[Dialect]:
    return [d for d in registry.every() if d.bus == "serial"]
