"""Sinks in a process of their own: one core frames, decodes and pairs while another writes.

    pipeline -> SinkProcess | pipe | worker -> sinks

The pipe carries batches. A batch is a row of records, each after a tag byte:

    P  a frame of a lane: a fixed head, then the frame's bytes
    O  anything else: a length, then a pickle in which dialects, commands and forms are numbers of a shared table
       (the worker is forked, so it has the same objects)

Rules: order is kept. If the sinks are slower, the limit of the pipe holds the pipeline back. An error in a sink is raised
here as the same error. A worker whose parent is gone ends without finishing anything.
"""

from __future__ import annotations

import io
import pickle
import struct
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from analyzer.catalogue import Dialect, Role
from analyzer.entries import Entry, EventSink, PlainSink, RunSink, Sink, plain_entry
from analyzer.records import CanFrame, Comment, Event, Finding, Frame, Junk, Lane
from analyzer.sinks.forked import Ends, Forked
from analyzer.sinks.object_table import Table, TableUnpickler, dumped

if TYPE_CHECKING:
    from analyzer.columns.plain import Plain

_PLAIN, _OTHER = b"P", b"O"
#: tag, lane, sequence, first_ns, last_ns, offset, latency_ns or -1, request sequence or -1, length
_HEAD = struct.Struct("<cHQqqQqqH")
_LENGTH = struct.Struct("<cI")
#: Bytes that are collected before they go into the pipe.
_BATCH = 1 << 16


class SinkProcess:
    """A sink that passes everything on to sinks in another process.

    `table`: of all dialects that may come up. `make`: called in the worker, returns the sinks there. `call` runs a method of
    one of them and returns its result.
    """

    def __init__(self, table: Table, make: Callable[[], Sequence[Sink]]) -> None:
        self._table = table
        #: By lane, and by who sent it where the capture marks that.
        self._lanes: dict[object, int] = {}
        self._parts: list[bytes] = []
        self._size = 0
        self._worker = Forked(lambda ends: _work(ends, self._table, make))

    # --- sink -----------------------------------------------------------------------------------------------------

    def plain(self, lane: Lane, frame: Frame, sequence: int, latency_ns: int | None, request_sequence: int | None) -> None:
        number = self._number(lane, frame)
        data = frame.data
        head = _HEAD.pack(
            _PLAIN, number, sequence, frame.first_ns, frame.last_ns, frame.offset,
            -1 if latency_ns is None else latency_ns, -1 if request_sequence is None else request_sequence, len(data),
        )  # fmt: skip
        parts = self._parts
        parts.append(head)
        parts.append(data)
        self._size += 53 + len(data)
        if self._size >= _BATCH:
            self._flush()

    def begin(self, plain: Plain) -> None:
        """Pass a block on, its lanes as numbers."""
        rows = plain.firsts(0, len(plain.lane)).tolist()
        lanes = tuple(self._number(lane, plain.frame(row)) for lane, row in zip(plain.lanes, rows, strict=True))
        columns = plain.lane, plain.offsets, plain.behind, plain.latencies
        self._other(("begin", (plain.dialect, plain.block, lanes, *columns)))

    def run(self, start: int, stop: int, sequence: int) -> None:
        self._other(("run", (start, stop, sequence)))

    def entry(self, entry: Entry) -> None:
        self._other(("entry", (entry,)))

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        self._other(("junk", (junk, sequence, topic)))

    def finding(self, found: Finding) -> None:
        self._other(("finding", (found,)))

    def comment(self, comment: Comment) -> None:
        self._other(("comment", (comment,)))

    def happened(self, event: Event, sequence: int) -> None:
        self._other(("happened", (event, sequence)))

    # --- calls ----------------------------------------------------------------------------------------------------

    def call(self, sink: int, method: str, *arguments: Any) -> Any:
        """Call a method of a sink, after everything that was passed on so far, and return its result.

        An empty method returns the sink itself. Raises what the sinks raised.
        """
        self._other(("call", (sink, method, arguments)))
        self._flush()
        return self._answer()

    def abandon(self) -> None:
        """End the worker at once, with nothing finished."""
        self._worker.kill()
        self._worker.ended()

    def close(self) -> None:
        self._worker.ended()

    def _answer(self) -> Any:
        answer = self._worker.take()
        if not answer:
            raise OSError("the process that writes the log has died")
        good, result = pickle.loads(answer)
        if not good:
            raise result
        return result

    def _number(self, lane: Lane, frame: Frame) -> int:
        key = id(lane) if frame.role is Role.UNKNOWN else (id(lane), frame.role)
        number = self._lanes.get(key)
        if number is not None:
            return number
        number = self._lanes[key] = len(self._lanes)
        about = (frame.dialect, lane.role, lane.address, lane.command, lane.form, lane.start, lane.stop, lane.topic)
        assert self._table.number(lane.command) is not None  # lanes are of the dialects that the pipeline was made with
        self._other(("lane", (about, frame.port, frame.role, None if frame.can is None else frame.can.id)))
        return number

    def _other(self, what: tuple[str, tuple[Any, ...]]) -> None:
        data = dumped(what, self._table)
        self._parts += (_LENGTH.pack(_OTHER, len(data)), data)
        self._size += len(data)
        if self._size >= _BATCH:
            self._flush()

    def _flush(self) -> None:
        batch = b"".join(self._parts)
        self._parts.clear()
        self._size = 0
        try:
            self._worker.give(batch)
        except BrokenPipeError:
            # The worker has ended; what it says of the reason is worth more than the broken pipe.
            self._answer()
            raise


# --- the worker ---------------------------------------------------------------------------------------------------


def _work(ends: Ends, table: Table, make: Callable[[], Sequence[Sink]]) -> None:
    """Run the sinks until the pipe ends."""
    try:
        _serve(ends, table, make())
    except BrokenPipeError:
        raise
    except BaseException as error:
        # The parent raises the same error again.
        ends.give(pickle.dumps((False, error if isinstance(error, Exception) else OSError(repr(error)))))


def _serve(ends: Ends, table: Table, sinks: Sequence[Sink]) -> None:
    plain_sinks = [s.plain for s in sinks if isinstance(s, PlainSink)]
    others = [s for s in sinks if not isinstance(s, PlainSink)]
    run_sinks = [s for s in sinks if isinstance(s, RunSink)]
    event_sinks: list[Any] = [s for s in sinks if isinstance(s, EventSink)]
    lanes: list[tuple[Lane, Dialect, str, Role, CanFrame | None]] = []
    head, plain_tag, other_tag = _HEAD.size, _PLAIN[0], _OTHER[0]
    unpack = struct.Struct("<xHQqqQqqH").unpack_from
    while batch := bytes(ends.take()):
        at, end = 0, len(batch)
        while at < end:
            if batch[at] == plain_tag:
                number, sequence, first_ns, last_ns, offset, latency, asked_by, length = unpack(batch, at)
                lane, dialect, port, role, can = lanes[number]
                at += head
                data = batch[at : at + length]
                at += length
                frame = Frame(port, first_ns, last_ns, offset, data, dialect, role, True, can)
                latency_ns = None if latency < 0 else latency
                request = None if asked_by < 0 else asked_by
                for plain in plain_sinks:
                    plain(lane, frame, sequence, latency_ns, request)
                for sink in others:
                    sink.entry(plain_entry(lane, frame, sequence, latency_ns, request))
                continue
            assert batch[at] == other_tag  # there are no others
            length = int.from_bytes(batch[at + 1 : at + 5], "little")
            at += 5
            what, arguments = TableUnpickler(io.BytesIO(batch[at : at + length]), table).load()
            at += length
            if what == "lane":
                lanes.append(_lane(*arguments))
            elif what == "call":
                index, method, rest_of = arguments
                ends.give(pickle.dumps((True, getattr(sinks[index], method)(*rest_of) if method else sinks[index])))
            elif what == "begin":
                block = _plain(lanes, *arguments)
                for taker in run_sinks:
                    taker.begin(block)
            elif what == "run":
                for taker in run_sinks:
                    taker.run(*arguments)
            else:
                for sink in event_sinks if what == "happened" else sinks:
                    getattr(sink, what)(*arguments)


def _plain(known: Sequence[tuple[Lane, Dialect, str, Role, CanFrame | None]], *about: Any) -> Plain:
    from analyzer.columns.plain import Plain

    dialect, block, numbers, *rest = about
    return Plain(dialect, block, tuple(known[n][0] for n in numbers), *rest)


def _lane(
    about: tuple[Any, ...], port: str, marked: Role, can_id: int | None
) -> tuple[Lane, Dialect, str, Role, CanFrame | None]:
    dialect, role, address, command, form, start, stop, topic = about
    lane = Lane(dialect, role, address, command, form, start, stop)
    lane.topic = topic
    # All frames of a lane have the same identifier, so one CAN frame stands for them all.
    can = None if can_id is None else CanFrame(None, port, can_id, b"")
    return lane, dialect, port, marked, can
