"""Raw bytes: what a terminal program saved, or `cat` of a port. No times, no directions, no marks.

Any file could be raw bytes, so only binary data is taken for this format. A text is read as raw bytes only on demand.
"""

from __future__ import annotations

from collections.abc import Iterator

from analyzer.records import Chunk
from analyzer.sources.lines import is_text
from analyzer.sources.source import Source

#: Bytes after which no magic number of another format can come any more.
_ENOUGH = 16


def score(head: bytes) -> float:
    """Say how sure it is that these bytes are raw traffic, 0..1: only where nothing else fits."""
    if is_text(head):
        return 0.0
    return 0.5 if len(head) >= _ENOUGH else 0.3


def read(source: Source) -> Iterator[Chunk]:
    """Read the bytes as they come."""
    port = source.port()
    return (Chunk(None, port, block) for block in iter(source.stream.block, b""))
