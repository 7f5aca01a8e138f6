"""MF4, ASAM measurement data with CAN bus logging, through python-can and asammdf (extra `mf4`).

asammdf needs a whole file that it can seek in. So standard input and compressed files are put into a temporary file first,
and a truncated file cannot be read at all. asammdf runs in a process of its own, which a damaged file may crash (see
`mf4_child.py`). Times are float seconds since the start of the measurement, good to 1 us.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import subprocess
from collections.abc import Iterator
from typing import IO

import msgspec

from analyzer.catalogue import Role
from analyzer.errors import UnreadableError
from analyzer.records import CanFrame
from analyzer.sources import magic
from analyzer.sources.budget import child_limits
from analyzer.sources.mf4_child import Batch
from analyzer.sources.source import Source
from analyzer.system import bounded, sized
from analyzer.system.scratch import scratch_folder

_SHORT = "reading the MF4 file takes more memory than a process may have for it"
#: What asammdf opens as it is; by other endings it guesses at archives, which it deletes after use.
_ENDINGS = (".mf4", ".mdf")


def read(source: Source) -> Iterator[CanFrame]:
    """Read the frames. Raises UnreadableError if asammdf is not installed."""
    source.time_source = "capture: the start of the measurement and float seconds, good to 1 us"
    if not source.head.startswith(magic.MF4):
        shown = source.head[:8].hex(" ").upper()
        raise UnreadableError(f"{source.name}: expected an MF4 file (4D 44 46 20 ...), got {shown}")
    if not _installed():
        raise UnreadableError(f"{source.name} is an MF4 file, which needs asammdf: pip install 'servotap[mf4]'")
    return _records(source)


def _installed() -> bool:
    try:
        return importlib.util.find_spec("asammdf") is not None
    except ValueError:
        return False


def _records(source: Source) -> Iterator[CanFrame]:
    with contextlib.ExitStack() as stack:
        # asammdf leaves a file of its own there when it is ended.
        folder = str(stack.enter_context(scratch_folder()))
        path = _as_file(source, folder)
        size = os.stat(path).st_size
        child = subprocess.Popen(
            bounded.command("analyzer.sources.mf4_child", os.path.abspath(path), *child_limits(size)),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            # Each thread of its libraries would take memory of its own on a machine with many processors.
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "TMPDIR": folder, "TEMP": folder},
        )
        stack.callback(_end, child)
        assert child.stdout is not None
        for batch in _batches(child.stdout):
            for row in batch.rows:
                source.stream.budget.record()
                port = source.port(f"can{row.channel}" if row.channel is not None else None)
                role = Role.REQUEST if row.sent else Role.UNKNOWN
                taken = CanFrame(row.t_ns, port, row.id, row.data, role, row.extended, row.remote, row.error, row.fd)
                yield source.carried(taken)
            if batch.failure and not batch.opened:
                what = _SHORT if batch.short else "the MF4 file is damaged or broken off, expected a whole one"
                raise UnreadableError(f"{source.name}: {what}: {batch.failure}")
            if batch.failure:
                source.problem(f"{_SHORT if batch.short else 'the MF4 file is damaged'}: {batch.failure}")
            if batch.last:
                return
        memory, seconds = child_limits(size)
        source.problem(
            f"the MF4 file is damaged: asammdf crashed on it (exit code {child.wait()}), or needed more than "
            f"{memory >> 20} MiB or {seconds} s"
        )


def _batches(pipe: IO[bytes]) -> Iterator[Batch]:
    """Yield what the child sends, until it ends or dies."""
    decode = msgspec.msgpack.Decoder(Batch).decode
    while data := sized.take(pipe):
        yield decode(data)


def _end(child: subprocess.Popen[bytes]) -> None:
    if child.stdout is not None:
        child.stdout.close()
    child.kill()
    child.wait()


def _as_file(source: Source, folder: str) -> str:
    """Return the path of a file with the unpacked bytes: the source itself, or a copy in this folder."""
    stream = source.stream
    if source.size is not None and not stream.compression and source.path.lower().endswith(_ENDINGS):
        stream.drain()
        return source.path
    source.note("MF4 cannot be streamed: it was copied to a temporary file first")
    path = os.path.join(folder, "copy.mf4")
    with open(path, "wb") as file:
        while block := stream.block():
            file.write(block)
    return path
