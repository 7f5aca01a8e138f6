"""Levels as records: edges are gathered until the channels can be chosen, and then read stretch by stretch.

Rules: memory holds `_MOST_EDGES` edges at most, and of longer captures only those of the chosen channels. A record has the time
of its end: of the stop bit, of EOF. Bytes with an error or a doubtful bit are given on. An event stands before the first of
them, and before others once in `_TOLD_NS`, with how many there were. All channels are read up to the same time, so records
come in order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from analyzer.catalogue import Role
from analyzer.columns.codec import Integers
from analyzer.logic import can, uart
from analyzer.logic.levels import Levels
from analyzer.records import CanFrame, Chunk, Event
from analyzer.sources.logic.channels import Channel, choose
from analyzer.sources.logic.waveform import Stretch, Waveform
from analyzer.sources.marks import ReceivedMarks
from analyzer.sources.source import Source, quote
from analyzer.values import SECOND_NS, counted

#: Edges that are kept until the channels are chosen, and that are read at once.
_MOST_EDGES, _TOGETHER = 8_000_000, 250_000
#: Time between two events that tell of bytes with errors: some frames.
_TOLD_NS = 10_000_000
#: What can be wrong with a byte, as events count it.
_WRONG = ("", "frame", "parity", "doubtful")
_BYTES = [bytes((value,)) for value in range(256)]
Item = Chunk | CanFrame | Event


def records(source: Source, wave: Waveform) -> Iterator[Item]:
    """Yield the traffic of a capture in the order of its times. Raises what `choose` does."""
    gathered: list[Stretch] = []
    stretches = _to_an_end(wave.stretches)
    edges = 0
    for stretch in stretches:
        gathered.append(stretch)
        edges += sum(map(len, stretch.edges))
        if edges > _MOST_EDGES:
            break
    end_ns = gathered[-1].end_ns if gathered else 0
    lines = [
        Levels(wave.first[place] if wave.first else 0, _joined(gathered, place), 0, end_ns) for place in range(len(wave.names))
    ]
    gathered.clear()
    chosen = choose(source, wave.names, lines, wave.step_ns, wave.rated)
    if all(each.spoken.kind == "can" for each in chosen):
        source.kind = "can"
    heard = ReceivedMarks()
    scale = _scale(source, wave, chosen)
    readers = [_Reader(source, each, wave.first[each.place], scale, heard) for each in chosen]
    parts = [lines[each.place].edges for each in chosen]
    lines.clear()
    yield from _pieces(readers, parts, end_ns)
    del parts
    for stretch in stretches:
        end_ns = stretch.end_ns
        yield from _fed(readers, [stretch.edges[each.place] for each in chosen], end_ns)
    yield from _fed(readers, [np.array([], dtype=np.int64)] * len(readers), end_ns, final=True)
    for each in readers:
        each.tell()


def _to_an_end(stretches: Iterator[Stretch]) -> Iterator[Stretch]:
    """Yield stretches; where a capture ends with an edge, its end is not known, and the lines are taken to stay as they are."""
    last_ns = end_ns = -1
    channels = 0
    for stretch in stretches:
        last_ns = max((int(edges[-1]) for edges in stretch.edges if len(edges)), default=last_ns)
        end_ns, channels = stretch.end_ns, len(stretch.edges)
        yield stretch
    if last_ns == end_ns >= 0:
        yield Stretch([np.array([], dtype=np.int64)] * channels, end_ns + SECOND_NS)


def _joined(stretches: Sequence[Stretch], place: int) -> Integers:
    return np.concatenate([stretch.edges[place] for stretch in stretches]) if stretches else np.array([], dtype=np.int64)


def _scale(source: Source, wave: Waveform, chosen: Sequence[Channel]) -> float | None:
    """Return the ns of a sample, where they are counted in samples; None where that is not known, so there are no times."""
    if wave.rated:
        return 1.0
    if source.baud is None:
        source.note("the capture does not say its sample rate: give --baud to turn sample numbers into times")
        return None
    source.time_source = f"capture: sample numbers, at {source.baud} baud by the length of the bits"
    return SECOND_NS / source.baud / chosen[0].spoken.form.bit_ns


def _pieces(readers: Sequence[_Reader], parts: Sequence[Integers], end_ns: int) -> Iterator[Item]:
    """Read many edges in pieces of the same time."""
    longest = max(parts, key=len)
    bounds = [int(longest[place]) for place in range(_TOGETHER, len(longest), _TOGETHER)]
    taken = [0] * len(parts)
    for bound in [*bounds, end_ns]:
        places = [int(np.searchsorted(edges, bound, side="right")) for edges in parts]
        own = [edges[start:stop] for edges, start, stop in zip(parts, taken, places, strict=True)]
        yield from _fed(readers, own, bound)
        taken = places


def _fed(readers: Sequence[_Reader], edges: Sequence[Integers], end_ns: int, *, final: bool = False) -> Iterator[Item]:
    found = [item for reader, own in zip(readers, edges, strict=True) for item in reader.take(own, end_ns, final=final)]
    if len(readers) > 1:
        found.sort(key=lambda item: item[0])
    for _, reader, item in found:
        yield reader.heard(item)


class _Reader:
    """Reads one channel, stretch by stretch."""

    def __init__(self, source: Source, channel: Channel, first: int, scale: float | None, marks: ReceivedMarks) -> None:
        self._source = source
        self._channel = channel
        self._form = channel.spoken.form
        self._rest = Levels(first, np.array([], dtype=np.int64), 0, 0)
        self._scale = scale
        self._marks = marks
        self._port = source.port(channel.port, channel.spoken.kind if channel.port else "")
        self._bad = dict.fromkeys(_WRONG[1:], 0)
        self._all_bad = dict(self._bad)
        self._told_ns = -_TOLD_NS
        self._silent = self._fd = self._first_fd_ns = self._frames = 0

    def take(self, edges: Integers, end_ns: int, *, final: bool) -> list[tuple[int, _Reader, Item]]:
        """Return what ends in the stretch up to a time, with the time that it is ordered by."""
        levels = self._rest.then(edges, end_ns)
        taken = self._bytes(levels, final) if self._channel.spoken.kind == "serial" else self._can_frames(levels, final)
        return [(t_ns, self, item) for t_ns, item in taken]

    def heard(self, item: Item) -> Item:
        """Return an item with who sent it, as far as that is known by then."""
        role = self._channel.role
        if role is Role.UNKNOWN or not isinstance(item, Chunk):
            return item
        return Chunk(item.t_ns, item.port, item.data, self._marks(role))

    def _time(self, t_ns: int) -> int | None:
        return t_ns if self._scale == 1.0 else None if self._scale is None else round(t_ns * self._scale)

    def _bytes(self, levels: Levels, final: bool) -> Iterator[tuple[int, Item]]:
        found = uart.read(levels, self._form, final=final)
        self._rest = found.rest
        port = self._port
        # What is wrong with each byte: the first of these.
        wrong = np.select((found.bad_stop, found.bad_parity, found.doubtful), (1, 2, 3))
        for t_ns, value, what in zip(found.ends.tolist(), found.values.tolist(), wrong.tolist(), strict=True):
            if what:
                self._bad[_WRONG[what]] += 1
                yield from self._errors(t_ns)
            yield t_ns, Chunk(self._time(t_ns), port, _BYTES[value])
        if final:
            self._told_ns = -_TOLD_NS
            yield from self._errors(levels.end_ns)

    def _errors(self, t_ns: int) -> Iterator[tuple[int, Item]]:
        """Yield an event that counts the errors since the last one, unless that has just been."""
        time = self._time(t_ns)
        if time is None or not any(self._bad.values()) or t_ns - self._told_ns < _TOLD_NS:
            return
        self._told_ns = t_ns
        for name, count in self._bad.items():
            self._all_bad[name] += count
        yield t_ns, Event(time, self._port, "overrun", {name: count for name, count in self._bad.items() if count})
        self._bad = dict.fromkeys(self._bad, 0)

    def _can_frames(self, levels: Levels, final: bool) -> Iterator[tuple[int, Item]]:
        found = can.read(levels, self._form.bit_ns, inverted=self._form.inverted, final=final)
        self._rest = found.rest
        self._first_fd_ns = self._first_fd_ns or found.first_fd_ns
        self._fd += found.fd
        for seen in found.frames:
            self._frames += not seen.error
            self._silent += not seen.error and not seen.acknowledged
            frame = CanFrame(
                self._time(seen.t_ns), self._port, seen.id, seen.data, Role.UNKNOWN, seen.extended, seen.remote, seen.error
            )
            yield seen.t_ns, frame

    def tell(self) -> None:
        """Note what the whole channel showed."""
        name = quote(self._channel.name)
        bad = {what: self._all_bad[what] + self._bad[what] for what in self._bad}
        if bad["frame"] or bad["parity"]:
            self._source.note(f"{counted(bad['frame'] + bad['parity'], 'byte')} with a parity or framing error")
        if bad["doubtful"]:
            self._source.note(
                f"{name}: {counted(bad['doubtful'], 'byte')} with a doubtful bit, which may be wrong: "
                "edges near the middle of a bit, or glitches"
            )
        if self._fd:
            self._source.note(
                f"{name}: {counted(self._fd, 'CAN FD frame')} passed over, the first at {self._first_fd_ns / SECOND_NS:.6f} s: "
                "only classic CAN is read"
            )
        if self._silent and self._silent == self._frames:
            self._source.note(f"{name}: no frame is acknowledged: it may be the TX pin of a controller; probe its RX pin")
