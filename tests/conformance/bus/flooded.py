"""A line on which a server sends without end, on a clock that moves with what is read."""

from __future__ import annotations

from analyzer.live.endpoint import parse
from conformance.bus.stream import READ_SIZE, StreamLine

MS = 1_000_000


class Flooded(StreamLine):
    """A line that always has more. `frame`: what it sends again and again; `written`: what was sent, and when.

    A look at it takes 0.1 ms.
    """

    def __init__(self, frame: bytes, place: str = "tcp:127.0.0.1:1,baud=38400") -> None:
        super().__init__(parse(place))
        self._t_ns = 0
        self._data = (frame * (READ_SIZE // len(frame) + 1))[:READ_SIZE]
        self.written: list[tuple[int, bytes]] = []

    def now_ns(self) -> int:
        return self._t_ns

    def fileno(self) -> int:
        raise NotImplementedError

    def _wait(self, timeout_ns: int) -> bool:
        return True

    def _read(self) -> bytes:
        self._t_ns += MS // 10
        return self._data

    def _pause(self, seconds: float) -> None:
        self._t_ns += int(seconds * 1000 * MS)

    def _put(self, data: bytes) -> int:
        self.written.append((self._t_ns, data))
        return len(data)

    def _shut(self) -> None:
        pass

    def set_speed(self, bits_per_second: int) -> None:
        raise NotImplementedError
