"""The contract of every source, of any format: run on a small valid capture."""

from __future__ import annotations

import hashlib
from pathlib import Path

from analyzer.catalogue import Role
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk, Comment, Event
from analyzer.sources import Record, Source, open_source

#: A capture is cut at each of this many parts of its length.
PARTS = 7


def read_all(path: Path, **options: object) -> tuple[Source, list[Record]]:
    """Read a capture to its end and close it."""
    with open_source(path, **options) as source:  # type: ignore[arg-type]
        return source, list(source)


def check_source(path: Path, *, format: str, kind: str, baud: int | None = None, parts: int = PARTS) -> list[Record]:
    """Check a whole capture, and every cut of it; return the records of the whole one.

    `format`: what it must be found to be. `parts`: into how many the capture is divided to cut it there.
    """
    source = open_source(path, baud=baud)
    assert source.format == format
    assert source.kind == kind
    assert source.size == path.stat().st_size
    assert source.name == path.name
    assert source.time_source
    records: list[Record] = []
    positions = [source.position()]
    for record in source:
        check_record(record)
        records.append(record)
        positions.append(source.position())
    assert records
    assert positions == sorted(positions)
    assert source.position() == source.size
    assert source.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert source.problems == []
    assert list(source) == []
    source.close()
    source.close()
    assert read_all(path, format=format, baud=baud)[1] == records
    _check_cuts(path, format, baud, records, parts)
    return records


def check_record(record: Record) -> None:
    """Check the types of a record's parts."""
    assert isinstance(record, Chunk | CanFrame | Comment | Event)
    assert record.t_ns is None or type(record.t_ns) is int
    assert record.port
    assert type(record.port) is str
    if isinstance(record, Comment | Event):
        assert record.text if isinstance(record, Comment) else record.values
        return
    assert type(record.data) is bytes
    assert type(record.direction) is Role
    if isinstance(record, Chunk):
        assert record.data
        return
    assert 0 <= record.id <= 0x1FFF_FFFF
    assert all(type(flag) is bool for flag in (record.extended, record.remote, record.error, record.fd))


def _check_cuts(path: Path, format: str, baud: int | None, whole: list[Record], parts: int) -> None:
    """Check that a cut capture gives a beginning of the whole one's records, and raises nothing unforeseen."""
    data = path.read_bytes()
    cut = path.with_name("cut-" + path.name)
    for part in range(parts):
        cut.write_bytes(data[: len(data) * part // parts])
        for forced in (None, format):
            given: list[Record] = []
            try:
                with open_source(cut, format=forced, baud=baud) as source:
                    for record in source:
                        check_record(record)
                        given.append(record)
                    assert source.sha256 == hashlib.sha256(cut.read_bytes()).hexdigest()
            except ServotapError:
                pass
            if forced is not None and given:
                # The record that the cut goes through may be shorter, or of another kind, and an event may tell of it.
                traffic = [record for record in given if not isinstance(record, Event)][:-1]
                assert traffic == [record for record in whole if not isinstance(record, Event)][: len(traffic)]
    cut.unlink()
