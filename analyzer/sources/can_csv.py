"""CSV as python-can's CSV writer puts CAN frames, through python-can.

    timestamp,arbitration_id,extended,remote,error,dlc,data
    1483389946.197,0x1,0,0,0,4,9gFAAg==

Times are exact to their digits. The format names neither the bus nor who sent a frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any, cast

from analyzer.records import CanFrame
from analyzer.sources.can_library import Tap, frames
from analyzer.sources.lines import Lines, head_lines
from analyzer.sources.source import Source, quote
from analyzer.sources.times import number_ns
from analyzer.system.own_process import without

if TYPE_CHECKING:
    from can import Message

_HEADER = "timestamp,arbitration_id,extended,remote,error,dlc,data"


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are python-can's CSV, 0..1."""
    lines = head_lines(head)
    return 1.0 if lines and lines[0].strip() == _HEADER else 0.0


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames."""
    source.time_source = "capture: seconds as printed, exact to their digits"
    return _records(source)


def _records(source: Source) -> Iterator[CanFrame]:
    with without("asammdf"):
        from can.io.csv import CSVReader

    # The reader always skips the first line; a log that was appended to has headers inside.
    tap = Tap(Lines(source), lambda line: False, lambda line: bool(line.strip()) and line.strip() != _HEADER, (_HEADER,))

    def place(message: Message) -> tuple[int | None, str]:
        stamp, *_, data = tap.line.split(",")
        if message.is_remote_frame and data.strip():
            # python-can leaves it out itself.
            source.problem(f"a remote frame carries no data, got {quote(data.strip())}, which is left out", line=tap.number)
        try:
            t_ns = number_ns(stamp.strip())
        except ValueError:
            source.problem(f"expected seconds, got {stamp[:40]!r}; the frame is kept", line=tap.number)
            t_ns = None
        return t_ns, source.port()

    return frames(source, tap, cast(Callable[[Tap], Any], CSVReader), place)
