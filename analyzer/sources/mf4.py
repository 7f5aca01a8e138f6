"""MF4, ASAM measurement data with CAN bus logging, through python-can and asammdf (extra `mf4`).

asammdf needs a whole file that it can jump about in: standard input and compressed files are put into a temporary
file first, and of a file that breaks off nothing can be read. Times are float seconds since the start of the
measurement, good to 1 us.
"""

from __future__ import annotations

import contextlib
import io
import logging
import mmap
import os
import tempfile
from collections.abc import Callable, Iterator
from typing import Any, cast

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources.can_library import float_ns, frame
from analyzer.sources.source import Source, describe

#: What asammdf opens as it is.
_ENDINGS = (".mf4", ".mdf")
_MAGICS = (b"MDF     ", b"UnFinMF ")


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are MF4, 0..1."""
    return 1.0 if head.startswith(_MAGICS) else 0.0


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames. Raises UnreadableError if asammdf is not installed."""
    source.time_source = "capture: the start of the measurement and float seconds, good to 1 us"
    try:
        import asammdf  # noqa: F401
    except ImportError as error:
        raise UnreadableError(
            f"{source.name} is an MF4 file, which needs asammdf: pip install 'servotap[mf4]' ({error})"
        ) from None
    return _records(source)


def _records(source: Source) -> Iterator[CanFrame]:
    from can.io.mf4 import MF4Reader

    # It writes tracebacks of files it cannot read to the terminal.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL + 1)
    with contextlib.ExitStack() as stack:
        path = stack.enter_context(_as_file(source))
        try:
            reader = cast(Callable[[str], Any], MF4Reader)(path)
        # asammdf raises whatever its parser stumbles over.
        except Exception as error:
            _defuse(error)
            raise UnreadableError(
                f"{source.name}: the MF4 file is damaged or broken off, expected a whole one: {describe(error)}"
            ) from None
        stack.callback(_stop, reader)
        for message in reader:
            name = f"can{message.channel}" if message.channel is not None else None
            yield frame(message, float_ns(message.timestamp), source.port(name))


def _defuse(error: BaseException) -> None:
    """Mark what asammdf half made as closed: else its destructor fails later and prints a traceback."""
    trace = error.__traceback__
    while trace is not None:
        made = trace.tb_frame.f_locals.get("self")
        if made is not None and hasattr(type(made), "__del__"):
            made._closed = True
            for part in vars(made).values():
                if isinstance(part, io.IOBase | mmap.mmap):
                    part.close()
        trace = trace.tb_next


def _stop(reader: Any) -> None:
    # Closing a file that was not understood fails on parts that were never made.
    with contextlib.suppress(Exception):
        reader.stop()


@contextlib.contextmanager
def _as_file(source: Source) -> Iterator[str]:
    """Give the path of a file with the unpacked bytes."""
    stream = source.stream
    # By other endings asammdf guesses at archives, which it deletes after use.
    if source.size is not None and not stream.compression and source.path.lower().endswith(_ENDINGS):
        stream.drain()
        yield source.path
        return
    source.note("MF4 cannot be streamed: it was copied to a temporary file first")
    handle, path = tempfile.mkstemp(suffix=".mf4")
    try:
        with os.fdopen(handle, "wb") as file:
            while block := stream.block():
                file.write(block)
        yield path
    finally:
        os.unlink(path)
