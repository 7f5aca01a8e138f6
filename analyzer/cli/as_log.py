"""Any capture as a log: a log as it is, anything else decoded into a temporary one."""

from __future__ import annotations

import argparse
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from analyzer.catalogue import Dialect
from analyzer.cli.decode import cores, decode, processes, watched_here
from analyzer.cli.decode_targets import Capture
from analyzer.cli.reading import asks_for_decoding, progress
from analyzer.cli.time_range import TimeRange
from analyzer.diagnosis.watch import Watch
from analyzer.sources import Source, open_source
from analyzer.sources.times import ShownTime
from analyzer.system.scratch import scratch_folder

#: Topics of decoded traffic, and how many records are looked through for the first one.
_DECODED = re.compile(r"/[^/]*/([^/]*/[^/]*/(request|reply|message)|unknown|foreign|junk)")
_LOOKED = 20_000


@dataclass
class AsLog:
    """A log to read: its source, and the time range that is wanted of it.

    `name`: of the capture; `watch`: what its decoding kept for a diagnosis, None where nothing was decoded.
    """

    source: Source
    name: str
    shown: ShownTime
    since_ns: int = -(1 << 63)
    until_ns: int = 1 << 63
    watch: Watch | None = None
    dialects: tuple[Dialect, ...] = ()
    notes: list[str] = field(default_factory=list)


@contextmanager
def as_log(path: str, arguments: argparse.Namespace) -> Iterator[AsLog]:
    """Open a capture as a log. Raises UnreadableError, and UsageError for options that do not fit it."""
    # A pipe can be read only once, so its format is not detected beforehand.
    again = path != "-" and not Path(path).is_fifo()
    if again and not asks_for_decoding(arguments) and _is_decoded(path):
        with open_source(path) as source:
            wanted = TimeRange(source, arguments.since, arguments.until, utc=arguments.utc)
            with progress(source, f"reading {source.name}"):
                yield AsLog(source, source.name, wanted.shown, wanted.since_ns, wanted.until_ns)
        return
    with scratch_folder() as folder:
        target = folder / "capture.mcap"
        given = argparse.Namespace(**vars(arguments) | {"to": "mcap", "jobs": processes(cores()), "force": True})
        done = decode(Capture(path, target), given, watched_here)
        if done.stopped.startswith("stopped"):
            raise KeyboardInterrupt
        reading = done.reading
        notes = [*reading.source.notes, *([done.stopped] if done.stopped else [])]
        with open_source(target) as source:
            shown = reading.time_range.shown
            yield AsLog(source, reading.source.name, shown, watch=done.watch, dialects=tuple(reading.dialects), notes=notes)


def _is_decoded(path: str) -> bool:
    """Say whether a capture is a log that holds more than what was received."""
    with open_source(path) as source:
        if source.kind != "log":
            return False
        from mcap.records import Channel

        from analyzer.sources.mcap_records import records

        found = (record for record in islice(records(source), _LOOKED) if isinstance(record, Channel))
        return any(_DECODED.fullmatch(channel.topic) for channel in found)
