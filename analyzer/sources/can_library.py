"""CAN captures through python-can: its messages become CAN frames, and a bad line costs only itself.

python-can reads text from an iterator of lines. The iterator here (`Tap`) remembers the last line, because exact times come
from the printed digits: the library's float seconds resolve only 238 ns. A bad line ends the library's reader. A new reader
then gets the header lines again and the rest of the file.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

from analyzer.catalogue import Role
from analyzer.errors import ServotapError
from analyzer.records import CanFrame
from analyzer.sources.lines import Lines, cut_note
from analyzer.sources.source import Source, describe, quote
from analyzer.values import CAN_ID_MASK, SECOND_NS, counted

if TYPE_CHECKING:
    from can import Message

# The library logs whole lines that it cannot read; without a handler they would end on the terminal.
logging.getLogger("can").addHandler(logging.NullHandler())

#: Data bytes of the longest frame (CAN FD).
MOST_BYTES = 64
#: Lines of a header that are kept to be given again.
HEADER_LIMIT = 200


def frame(message: Message, t_ns: int | None, port: str) -> CanFrame:
    """Return a message of python-can as a CAN frame.

    Only the mark of a sent frame tells its sender: a listener receives everything. Raises ValueError for no valid CAN frame.
    """
    if not 0 <= message.arbitration_id <= CAN_ID_MASK or len(message.data or b"") > MOST_BYTES:
        raise ValueError(
            f"expected an identifier of 29 bits and up to {MOST_BYTES} bytes, got {message.arbitration_id:#x} and "
            f"{counted(len(message.data), 'byte')}"
        )
    return CanFrame(
        t_ns,
        port,
        message.arbitration_id,
        bytes(message.data or b""),
        Role.UNKNOWN if message.is_rx else Role.REQUEST,
        message.is_extended_id and not message.is_error_frame,
        message.is_remote_frame,
        message.is_error_frame,
        message.is_fd,
    )


def float_ns(seconds: float) -> int:
    """Return float seconds as nanoseconds; a time of today is good to 240 ns."""
    whole = int(seconds)
    return whole * SECOND_NS + round((seconds - whole) * SECOND_NS)


class Tap:
    """An iterator of lines for a reader of python-can. `line` and `number`: of the line given last.

    `is_header(line)`: whether a line belongs to the header; the header ends with the first line that does not.
    `keep(line)`: called once with every line; the reader does not get those for which it is False. `insert`: lines to
    give after the header, for readers that swallow one there.
    """

    def __init__(
        self,
        lines: Lines,
        is_header: Callable[[str], bool],
        keep: Callable[[str], bool] | None = None,
        insert: Sequence[str] = (),
    ) -> None:
        self.lines = lines
        self._given = (line for line in lines if keep is None or keep(line))
        self._is_header = is_header
        self._insert = insert
        self._header: list[str] = []
        self._in_header = True
        self._again: list[str] = []
        self.line = ""

    @property
    def number(self) -> int:
        """Number of the line given last, from 1."""
        return self.lines.number

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        if self._again:
            return self._again.pop()
        line = self.line = next(self._given)
        if self._in_header:
            if self._is_header(line) and len(self._header) < HEADER_LIMIT:
                self._header.append(line)
            else:
                self._in_header = False
                if self._insert:
                    self._header += self._insert
                    self._again = [line, *reversed(self._insert)]
                    return self._again.pop()
        return line

    def restart(self) -> None:
        """Give the header again, then go on."""
        self._again = self._header[::-1]

    def close(self) -> None:
        """Do nothing: the source closes its file."""


def frames(
    source: Source, tap: Tap, reader: Callable[[Tap], Iterable[Message]], place: Callable[[Message], tuple[int | None, str]]
) -> Iterator[CanFrame]:
    """Yield a reader's messages as frames, past the lines it cannot read. `place`: the time of a message, and its port."""
    lines = -1
    while True:
        try:
            for message in reader(tap):
                yield source.carried(frame(message, *place(message)), tap.number)
            break
        except ServotapError:
            raise
        # A damaged line can make the library raise any exception.
        except Exception as error:
            if tap.number == lines:
                raise
            lines = tap.number
            source.problem(f"expected a frame, got {quote(tap.line.strip())!r} ({describe(error)})", line=lines)
            tap.restart()
    cut_note(source, tap.lines)
