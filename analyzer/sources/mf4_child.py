"""The process that reads an MF4 file: asammdf's native code can crash on a damaged one, and must not take us with it.

    parent --> path (argument)        child --> a message, msgpack of a Batch | ... | the last one

A stream that ends without a batch marked as last means that the process died.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import IO, Any, cast

import msgspec

from analyzer.system import bounded, sized

#: Frames of one batch.
BATCH = 500


class Row(msgspec.Struct, array_like=True):
    """A CAN frame on its way between the processes. `channel` None: the file names none."""

    t_ns: int
    channel: int | None
    id: int
    data: bytes
    sent: bool
    extended: bool
    remote: bool
    error: bool
    fd: bool


class Batch(msgspec.Struct, array_like=True):
    """Frames in order. `last`: nothing follows. `opened`: the file as a whole could be read. `failure`: in words.

    `short`: memory did not suffice.
    """

    rows: list[Row] = []
    last: bool = False
    opened: bool = True
    failure: str = ""
    short: bool = False


def main(out: IO[bytes], path: str, memory: str, seconds: str) -> None:
    """Write the frames of a file to `out`, within so many bytes of memory and so much CPU time."""
    logging.disable(logging.CRITICAL)
    bounded.limit(int(memory), int(seconds))
    opened = False
    rows: list[Row] = []
    try:
        from can.io.mf4 import MF4Reader

        reader = cast(Callable[[str], Any], MF4Reader)(path)
        opened = True
        for message in reader:
            rows.append(_row(message))
            if len(rows) >= BATCH:
                _send(out, Batch(rows))
                rows.clear()
        _send(out, Batch(rows, last=True))
    # A damaged file can make asammdf raise any exception.
    except Exception as error:
        said, short = f"{type(error).__name__}: {error}".rstrip(": ")[:400], isinstance(error, MemoryError)
        _send(out, Batch(rows, last=True, opened=opened, failure=said, short=short))


def _row(message: Any) -> Row:
    from analyzer.sources.can_library import float_ns, frame

    taken = frame(message, float_ns(message.timestamp), "")
    channel = message.channel if isinstance(message.channel, int) else None
    return Row(
        taken.t_ns or 0, channel, taken.id, taken.data, not message.is_rx, taken.extended, taken.remote, taken.error, taken.fd
    )


def _send(out: IO[bytes], batch: Batch) -> None:
    sized.put(out, msgspec.msgpack.encode(batch))
