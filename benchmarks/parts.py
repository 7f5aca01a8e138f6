"""Parts of the work that are measured alone, each with no more than it needs: `benchmarks/columns.py` runs them."""

from __future__ import annotations

import json
from pathlib import Path


def read(path: str) -> int:
    """Read a capture as `decode` does; return how many frames it has."""
    # What the program sets as it starts: NumPy has no threads that wait for matrices.
    import analyzer.__main__  # noqa: F401
    from analyzer.columns import memory
    from analyzer.columns.block import CanBlock
    from analyzer.sources import open_source

    memory.keep()
    with open_source(path) as source:
        source.in_blocks = True
        return sum(len(item) if isinstance(item, CanBlock) else 1 for item in source.items())


def show(path: str) -> int:
    """Filter a log as a plain script would."""
    from mcap.reader import make_reader

    count = 0
    with Path(path).open("rb") as stream:
        for _, channel, message in make_reader(stream).iter_messages():
            values = json.loads(message.data)
            count += channel.topic.endswith("/read_speed/reply") and values["speed"] > 2990
    return count


def unpack(path: str, raw: str) -> None:
    """Write what the chunks of a log hold."""
    import zstandard
    from mcap.records import Chunk
    from mcap.stream_reader import StreamReader

    with Path(path).open("rb") as stream, Path(raw).open("wb") as out:
        for each in StreamReader(stream, emit_chunks=True).records:
            if isinstance(each, Chunk):
                out.write(zstandard.decompress(each.data, each.uncompressed_size))


def pack(raw: str) -> int:
    """Compress what `unpack` wrote, in chunks as a log has them."""
    import zstandard

    size = 0
    with Path(raw).open("rb") as stream:
        while chunk := stream.read(1 << 20):
            size += len(zstandard.ZstdCompressor(level=1).compress(chunk))
    return size
