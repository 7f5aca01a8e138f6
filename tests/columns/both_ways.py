"""The same traffic through the pipeline one by one and by blocks, and all that comes out."""

from __future__ import annotations

import contextlib
import io
import json
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from mcap.reader import make_reader

from analyzer.catalogue import Dialect
from analyzer.columns import framing, pairs
from analyzer.columns.block import DIRECTIONS, CanBlock
from analyzer.context import Request
from analyzer.diagnosis.watch import Watch
from analyzer.errors import ServotapError
from analyzer.pipeline import Item, Pipeline
from analyzer.port import Options
from analyzer.records import CanFrame, Chunk
from analyzer.sinks.mcap_log import McapLog
from analyzer.sinks.summary import Summary
from analyzer.sources import blf_blocks, candump_blocks, found, open_source, source
from tests.columns.serial_traffic import byte_blocks


@contextlib.contextmanager
def short_runs() -> Iterator[None]:
    """Let runs and stretches without be short: so they begin and end at as many places as there can be."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pairs, "SHORTEST_RUN", 2)
        patch.setattr(pairs, "LEAST_SHARE", 0)
        patch.setattr(pairs, "AFTER_REFUSAL", 2)
        patch.setattr(framing, "SHORTEST_ROW", 1)
        patch.setattr(framing, "SHORTEST_TOGETHER", 2)
        patch.setattr(source, "SHORTEST_BLOCK", 1)
        for module in (found, blf_blocks, candump_blocks):
            patch.setattr(module, "SHORTEST", 2)
        yield


def messages(log: bytes) -> list[tuple[object, ...]]:
    """Return the messages of a log, whose checksums are looked at."""
    reader = make_reader(io.BytesIO(log), validate_crcs=True)
    return [
        (channel.topic, schema.name, m.sequence, m.log_time, m.publish_time, json.loads(m.data))
        for schema, channel, m in reader.iter_messages()
    ]


def outcome(
    items: Sequence[Item], dialect: Dialect | Sequence[Dialect], *, timed: bool = True
) -> tuple[dict[str, object], Pipeline]:
    """Return all that comes out of a pipeline that is fed these items."""
    dialects = [dialect] if isinstance(dialect, Dialect) else list(dialect)
    stream, summary, watch = io.BytesIO(), Summary(), Watch()
    log = McapLog(stream, bit_ns=2000)
    pipeline = Pipeline(dialects, [log, summary, watch], Options(timed=timed))
    for item in items:
        watch.take(item)
        pipeline.feed(item)
    before = {}
    for name, port in pipeline.ports.items():
        state = port.state()
        if state["framer"] is not None:
            state["framer"] = standing(state["framer"])
        before[name] = plain_values(state)
    pipeline.close()
    log.finish({})
    shown = [repr((s.bus, s.pieces, s.reads, s.findings, s.frames, s.timed)) for s in watch.scenes(dialects)]
    return {
        "messages": messages(stream.getvalue()),
        "summary": summary.settle().as_object(),
        "doubtful": summary.doubtful(),
        "watch": shown,
        "sequence": pipeline.sequence,
        "ports": before,
    }, pipeline  # fmt: skip


def standing(state: dict[str, Any]) -> dict[str, Any]:
    """Return of the state of a framer what tells how it goes on: what it holds, without what has been given away."""
    offset = state["_base"] + state["_junk_from"]
    shown: dict[str, Any] = {name: state[name] for name in ("_direction", "_last_ns", "_timed", "_step")}
    shown["held"] = state["_buffer"][state["_junk_from"] :]
    shown["at"] = state["_base"] + state["_at"]
    shown["bursts"] = [b for b in state["_bursts"] if b >= offset]
    shown["firm"] = {b for b in state["_firm"] if b >= offset}
    shown["marks"] = [m for m in state["_marks"] if m.stop > offset]
    return shown


def plain_values(value: object) -> object:
    """Return what can be compared: objects as their attributes, mappings without their order."""
    if isinstance(value, Request):
        kept = (value.message, value.sequence, value.topic, value.t_ns, value.state, value.outcome, value.gave_up)
        return plain_values(kept)
    if isinstance(value, dict):
        return {repr(key): plain_values(each) for key, each in value.items()}
    if isinstance(value, set):
        return sorted(map(repr, value))
    if isinstance(value, (list, tuple, deque)):
        return [plain_values(each) for each in value]
    return repr(value)


def blocks(frames: Sequence[CanFrame], most: int) -> Iterator[CanBlock | CanFrame]:
    """Yield frames as a reader of blocks does: what no block holds, singly."""
    held: list[CanFrame] = []
    for frame in frames:
        fits = not (frame.extended or frame.remote or frame.error or frame.fd) and frame.id <= 0x7FF
        fits = fits and len(frame.data) <= 8 and frame.t_ns is not None
        if held and (not fits or len(held) == most or frame.port != held[0].port or frame.t_ns < held[-1].t_ns):
            yield block(held)
            held = []
        if fits:
            held.append(frame)
        else:
            yield frame
    if held:
        yield block(held)


def block(frames: Sequence[CanFrame]) -> CanBlock:
    """Return frames of one bus as a block."""
    data = np.zeros((len(frames), 8), dtype=np.uint8)
    for row, frame in enumerate(frames):
        data[row, : len(frame.data)] = np.frombuffer(frame.data, dtype=np.uint8)
    numbers = [[f.t_ns, f.id, len(f.data), DIRECTIONS.index(f.direction)] for f in frames]
    t_ns, ids, sizes, directions = np.array(numbers, dtype=np.int64).T
    return CanBlock(frames[0].port, t_ns, ids, sizes, data, directions)


def same_capture(path: Path, dialect: Dialect) -> int:
    """Check that both ways give the same of a capture, and say the same of it. Return how many frames went by runs."""
    results: list[object] = []
    in_runs = 0
    for in_blocks in (False, True):
        try:
            with open_source(path) as source:
                source.in_blocks = in_blocks
                came, pipeline = outcome(list(source.items()), dialect)
                results.append((came, source.notes, source.problems))
                in_runs = pipeline.in_runs
        except ServotapError as error:
            results.append(str(error))
    assert results[0] == results[1]
    return in_runs


def same(frames: Sequence[CanFrame], dialect: Dialect, most: int) -> Pipeline:
    """Check that both ways give the same. Return the pipeline that took blocks."""
    return _same(frames, list(blocks(frames, most)), dialect)


def same_line(chunks: Sequence[Chunk], dialect: Dialect, most: int, *, timed: bool = True) -> int:
    """Check that both ways give the same of a serial line, with its times or without. Return how many frames went by runs."""
    if not timed:
        chunks = [msgspec.structs.replace(chunk, t_ns=None) for chunk in chunks]
    return _same(chunks, list(byte_blocks(chunks, most)), dialect, timed=timed).in_runs


def _same(singly: Sequence[Item], together: Sequence[Item], dialect: Dialect, *, timed: bool = True) -> Pipeline:
    streamed, _ = outcome(singly, dialect, timed=timed)
    columns, pipeline = outcome(together, dialect, timed=timed)
    for name, value in streamed.items():
        if isinstance(value, list):
            for one, other in zip(value, columns[name], strict=False):
                assert one == other, name
        assert value == columns[name], name
    return pipeline
