"""The frames of a text that is no file: what people paste on a command line, read as a capture would be."""

from __future__ import annotations

from typing import NamedTuple

from analyzer.errors import UnreadableError
from analyzer.records import CanFrame, Chunk
from analyzer.sources import open_source
from analyzer.system.scratch import scratch_folder


class Pasted(NamedTuple):
    """What a text holds: its traffic in order, and what was concluded of how it is written."""

    traffic: list[Chunk | CanFrame]
    notes: list[str]


def read_text(text: str) -> Pasted:
    """Return the traffic of a text in any form of capture; none where it is of no form."""
    with scratch_folder() as folder:
        path = folder / "text"
        path.write_text(text.rstrip("\n") + "\n", "utf-8", "replace")
        try:
            with open_source(path) as source:
                if source.format == "raw":
                    return Pasted([], [])
                return Pasted([record for record in source if isinstance(record, (Chunk, CanFrame))], source.notes)
        except UnreadableError:
            return Pasted([], [])
