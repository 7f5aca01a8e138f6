"""The end of a log that is still being written: reading waits for what is not there yet.

Rules: a record is only read when it is there as a whole. `Rewound` reports a log that gets shorter: after a kill, the next
process writes the last second anew. Waiting ends when no process writes any more.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

#: Time between two looks at the file, and the number of looks between two checks for a writer.
_LOOK_S = 0.1
_ASK_EVERY = 10


@dataclass
class Follow:
    """How a log is followed. `alive`: says whether a process writes it, None where that cannot be told; it is asked when
    nothing comes. `wait`: waits that many seconds.
    """

    alive: Callable[[Path], bool | None]
    wait: Callable[[float], None] = time.sleep


class Rewound(Exception):
    """The log has become shorter than what was read of it."""


class Tail:
    """One file. `finished`: it is known to be whole, so its end is the end. `why`: why waiting ended, empty before."""

    def __init__(self, path: Path, follow: Follow, *, finished: bool = False) -> None:
        self.path = path
        self._follow = follow
        self._finished = finished
        self._fd = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        self.offset = 0
        self.why = ""

    @property
    def size(self) -> int:
        """Bytes that are there now."""
        return os.fstat(self._fd).st_size

    def read(self, count: int) -> bytes:
        """Return `count` bytes, when they are there. Raises Rewound; EOFError when no process writes any more."""
        looks = 0
        dead = 0
        while self.size < self.offset + count:
            if self.size < self.offset:
                raise Rewound
            if self._finished:
                raise EOFError(f"{self.path.name} breaks off")
            looks += 1
            if looks % _ASK_EVERY == 0:
                # Twice: a process that was killed is started again soon.
                dead = dead + 1 if self._follow.alive(self.path) is False else 0
                if dead > 2:
                    self.why = f"no process writes {self.path.name} any more; servotap recover repairs it"
                    raise EOFError(self.why)
            self._follow.wait(_LOOK_S)
        data = b""
        while len(data) < count:
            # By place: what is read is not what another part of the program is at.
            os.lseek(self._fd, self.offset + len(data), os.SEEK_SET)
            more = os.read(self._fd, count - len(data))
            if not more:
                raise Rewound
            data += more
        self.offset += count
        return data

    def wait_for(self, path: Path) -> Path | None:
        """Return the next part when it is there; a later one where it was dropped already; None if none comes."""
        from analyzer.sources.recording_parts import base_of, parts_named

        for _ in range(10 * _ASK_EVERY):
            if path.exists():
                return path
            later = [p for p in parts_named(base_of(path)) if p.name > path.name]
            if later:
                return later[0]
            self._follow.wait(_LOOK_S)
        return None

    def __enter__(self) -> Tail:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        os.close(self._fd)
        self._fd = -1
