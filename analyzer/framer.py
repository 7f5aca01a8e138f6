"""The framer: the only resynchroniser, for every serial dialect. Bytes in, frames and junk out, nothing lost.

Theory of operation. The framer stands at a byte and asks the slicer of each dialect on the wire whether a frame begins
here. The answer is a length, nothing, or "more bytes are needed"; then it waits. Rules:

1. Each byte ends in exactly one frame or one piece of junk.
2. Chunks do not matter. A decision rests on bytes, on silences and on marks of the capture, never on where a read
   ended: where the next bytes could change a decision, the framer waits for them.
3. A frame is believed when another one or a boundary follows it. Where something else follows it is doubtful, for an
   8-bit sum fits by chance once in 256 times: it is weighed against other readings of the same bytes (`_doubtful`).
4. A failed check costs one byte of the input, not the buffer.
5. A known frame with only its check wrong is a frame (`checksum_ok` False) when a frame or a boundary follows it and
   none begins inside it.
6. A frame of unknown code is taken only when it fills a burst exactly, its check fits and no frame is inside. A known
   code of another length is taken so only where the burst ends firmly: a sum does not see zeros that were lost.
7. A package that lost zeros is a frame when a frame or a boundary follows it. Its check counts where its end is firm;
   elsewhere the sum has to say where it ends and cannot vouch for it too (`checksum_ok` False).

Boundaries: a *silence* (longer than any pause inside a frame, also behind a USB adapter) and a change of direction end
every wait; a *burst* (a line of a log, a packet, a shorter pause) ends none, but counts as evidence. All are firm but
the shorter pause.

Not known here: what a frame means. Only where readings are weighed does it count whether the manual allows the values.
`feed` yields one event at a time, so that its consumer can let the event's meaning reach the context before the framer
goes on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

from analyzer.catalogue import Dialect, Role
from analyzer.context import Context
from analyzer.junk import JUNK_PIECE, Reasons
from analyzer.link import MORE, TIE, Slicer, places_in
from analyzer.records import Chunk, Frame, Junk
from analyzer.slicers import Slicers

#: A pause that no adapter puts inside a frame: USB adapters hold bytes back for up to 16 ms.
SILENCE_NS = 25_000_000
#: Times that go back further than this begin anew; less is jitter and is smoothed.
JUMP_BACK_NS = 1_000_000_000
#: Characters of pause that end a burst.
BURST_CHARACTERS = 4
#: One byte at 9600 baud: where the speed of the line is unknown, the bytes of a chunk may have taken that long.
SLOWEST_BYTE_NS = 1_041_667
#: What one pulse on an idle line reads as: a start bit, zeros, then ones. Such a byte between frames is a glitch.
GLITCHES = frozenset((0x00, 0x80, 0xC0, 0xE0, 0xF0, 0xF8, 0xFC, 0xFE, 0xFF))
#: What follows a frame: a boundary. No frame is so short that its length could be taken for it.
BOUNDARY = 1

#: What of a framer is not given by its dialects.
_STATE = (
    "_buffer", "_base", "_at", "_junk_from", "_known", "_step", "_bursts", "_firm", "_marks", "_direction", "_last_ns",
    "_timed",
)  # fmt: skip


class Mark(NamedTuple):
    """Bytes that came in one chunk: where they end on the port, the time of the last one, and what came before them."""

    stop: int
    t_ns: int
    before_ns: int


class LineState(NamedTuple):
    """What a framer knows of its line. `offset`: on the port, of the first byte of `held`."""

    offset: int
    held: bytes
    marks: tuple[Mark, ...]
    bursts: tuple[int, ...]
    direction: Role
    last_ns: int
    timed: bool
    byte_ns: int
    silence_ns: int


def slowest_ns(byte_ns: int) -> int:
    """Return how long a byte can have taken on a line."""
    return byte_ns or SLOWEST_BYTE_NS


class Framer:
    """Frames the bytes of one port.

    `dialects`: all that may be on the wire. `byte_ns`: time of one byte on the wire, 0 where the speed is unknown (then
    all bytes of a chunk have its time). `silence_ns`: a pause longer than this ends every wait. `offset`: bytes of the port
    that came before the first one here.
    """

    def __init__(
        self,
        port: str,
        dialects: Sequence[Dialect],
        context: Context,
        *,
        byte_ns: int = 0,
        silence_ns: int = SILENCE_NS,
        offset: int = 0,
    ) -> None:
        self.port = port
        self.dialects = tuple(dialects)
        self._slicers = Slicers(dialects, context.expects)
        #: Where a frame may begin.
        self.starts = self._slicers.starts
        #: Why bytes are junk.
        self.reasons = Reasons(self._slicers)
        self._byte_ns = byte_ns
        self._silence_ns = silence_ns
        self._buffer = b""
        self._base = offset  # offset of the buffer's first byte on the port
        self._at = 0  # where the framer stands in the buffer
        self._junk_from = 0  # junk is buffer[_junk_from:_at]
        self._known = 0  # length of the frame at _at, 0 if not asked yet
        self._step = offset  # offset on the port where the last frame ends, or a boundary behind it
        self._bursts: deque[int] = deque((offset,))  # offsets on the port where a burst begins or ends, ascending
        self._firm: set[int] = {offset}  # those of them that are no mere pause
        self._marks: deque[Mark] = deque()
        self._direction = Role.UNKNOWN
        self._last_ns = 0
        self._timed = False

    @property
    def waiting(self) -> int:
        """Bytes that are held back because what follows could change what they are."""
        return len(self._buffer) - self._junk_from

    @property
    def pending(self) -> bytes:
        """The bytes that are held back."""
        return self._buffer[self._junk_from :]

    @property
    def between(self) -> bool:
        """No frame is half-way: nothing is held back, or whole frames alone, for what follows them."""
        if not self.waiting:
            return True
        return self._junk_from == self._at and self._known > BOUNDARY and self._at + self._known == len(self._buffer)

    def feed(self, chunk: Chunk) -> Iterator[Frame | Junk]:
        """Take a chunk; yield the frames and the junk that are certain by now.

        The chunk is taken while the events are: use them up before the next one.
        """
        size = len(chunk.data)
        if not size:
            return
        end = self._base + len(self._buffer)
        before_ns = self._last_ns
        if chunk.t_ns is not None:
            slowest = slowest_ns(self._byte_ns)
            pause = chunk.t_ns - before_ns - size * slowest if self._timed else 0
            if pause > self._silence_ns or chunk.t_ns < before_ns - JUMP_BACK_NS:
                yield from self.silence()
            elif pause >= BURST_CHARACTERS * slowest:
                self._add_burst(end)
            self._timed = True
            if chunk.t_ns < before_ns - JUMP_BACK_NS:
                # The clock was set, or two captures were glued: go on from there, or all that follows is one instant.
                before_ns = chunk.t_ns
            self._last_ns = max(before_ns, chunk.t_ns)
        if chunk.direction is not self._direction:
            yield from self.silence()
            self._direction = chunk.direction
        self._buffer = self._buffer[self._junk_from :] + chunk.data
        self._base += self._junk_from
        self._at -= self._junk_from
        self._junk_from = 0
        self._marks.append(Mark(end + size, self._last_ns, before_ns))
        if chunk.burst:
            for offset in (end, end + size):
                self._add_burst(offset)
                self._firm.add(offset)
        yield from self._advance(False)

    def silence(self) -> Iterator[Frame | Junk]:
        """End every wait: nothing more belongs to what has come so far."""
        yield from self._advance(True)
        yield from self._drop_junk()
        self._base += len(self._buffer)
        self._buffer = b""
        self._at = self._junk_from = self._known = 0
        self._bursts.clear()
        self._bursts.append(self._base)
        self._firm = {self._base}

    close = silence

    # --- beside a search by columns ---------------------------------------------------------------------------------

    @property
    def slicer(self) -> Slicer | None:
        """What finds the frames, where they are of one dialect."""
        return self._slicers.each[0] if len(self.dialects) == 1 else None

    @property
    def standing(self) -> int:
        """Offset on the port up to which all is given away, with a frame or a boundary right before; -1: it is not so."""
        offset = self._base + self._at
        return offset if self._at == self._junk_from and self._step == offset else -1

    @property
    def line(self) -> LineState:
        """What the framer knows of the line: what it holds, and when it came."""
        return LineState(
            self._base + self._junk_from, self.pending, tuple(self._marks), tuple(self._bursts), self._direction,
            self._last_ns, self._timed, self._byte_ns, self._silence_ns,
        )  # fmt: skip

    @property
    def end(self) -> int:
        """Offset on the port behind all bytes that have come."""
        return self._base + len(self._buffer)

    def go_on(self, offset: int, last_ns: int) -> Iterator[Frame | Junk]:
        """Go on behind frames that were found elsewhere, within the bytes that are here. `last_ns`: when the last came."""
        self._at = self._junk_from = offset - self._base
        self._known = 0
        self._step = offset
        self._last_ns = last_ns
        return self._advance(False)

    def go_on_in(self, chunk: Chunk, mark: Mark, offset: int) -> Iterator[Frame | Junk]:
        """Go on within a chunk, as `go_on` does: all before it has been dealt with. `mark`: of the chunk."""
        self._buffer = chunk.data
        self._base = mark.stop - len(chunk.data)
        self._marks.clear()
        self._marks.append(mark)
        self._bursts.clear()
        if chunk.burst:
            self._bursts.append(mark.stop)
        self._firm = set(self._bursts)
        self._direction = chunk.direction
        self._timed = True
        return self.go_on(offset, mark.t_ns)

    def state(self) -> dict[str, Any]:
        """Return what was seen so far, as plain values and records, for `restore`."""
        return {name: getattr(self, name) for name in _STATE}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where another framer of the same dialects stood. Raises KeyError for a state that is not whole."""
        for name in _STATE:
            setattr(self, name, state[name])

    def _add_burst(self, offset: int) -> None:
        """Note a boundary; offsets come in ascending order."""
        if not self._bursts or self._bursts[-1] < offset:
            self._bursts.append(offset)

    # --- the machine ----------------------------------------------------------------------------------------------

    def _advance(self, closed: bool) -> Iterator[Frame | Junk]:
        buffer, base, end, at = self._buffer, self._base, len(self._buffer), self._at
        looks, owners, bursts, marks = self._slicers.looks, self._slicers.owners, self._bursts, self._marks
        port, direction, byte_ns = self.port, self._direction, self._byte_ns
        length, self._known = self._known, 0
        while at < end:
            if bursts and bursts[0] <= base + at:
                yield from self._reach_burst()
            if not length:
                length = looks[buffer[at]](buffer, at, end, closed)
            follower, check_ok = 0, True
            if length == TIE:
                length = self._settled(at, closed)
            elif length > 0:
                stop = at + length
                # `_follower`, written out: this is the way of every frame of a clean line.
                if bursts and base + stop in bursts:
                    follower = BOUNDARY
                elif stop < end:
                    follower = looks[buffer[stop]](buffer, stop, end, closed)
                else:
                    follower = BOUNDARY if closed else MORE
                if follower == MORE:
                    self._known = length
                    return
                if follower == 0:
                    length = self._doubtful(at, length, closed)
                elif self._step != base + at:
                    length = self._out_of_step(at, length, closed)
            elif length == 0:
                length, check_ok = self._wrecked(at, closed)
            if length == MORE:
                return
            if length == 0:
                self._at = at = self._skip(at)
                if at - self._junk_from >= JUNK_PIECE:
                    yield from self._drop_junk()
                continue
            if at > self._junk_from:
                yield from self._drop_junk()
            stop = at + length
            start = base + at
            mark_stop, first_ns, before_ns = marks[0]
            last_ns = first_ns
            if base + stop > mark_stop:
                first_ns, last_ns = self._times(start, base + stop)
            elif byte_ns:
                # `_times`, written out for a frame that came in one chunk.
                last_ns = max(before_ns, last_ns - (mark_stop - base - stop) * byte_ns)
                first_ns = max(before_ns, first_ns - (mark_stop - 1 - start) * byte_ns)
            data = buffer[at:stop]
            dialect = owners[data[0]] or self.dialects[self._slicers.owner(data)]
            # The framer is ready for the next event before it gives this one away.
            self._at = self._junk_from = at = stop
            self._step = base + stop
            # Not so a `TIE`: it may be settled by what this frame brings to the context.
            self._known = length = follower if follower > BOUNDARY else 0
            yield Frame(port, first_ns, last_ns, start, data, dialect, direction, check_ok)
            self._known = 0

    def _look_at(self, at: int, closed: bool) -> int:
        """Look for a frame anywhere in the buffer."""
        return self._slicers.looks[self._buffer[at]](self._buffer, at, len(self._buffer), closed)

    def _shortest(self, at: int, closed: bool) -> int:
        """Return the length of the shortest frame that checks here, 0 for none, or `MORE`."""
        length = self._look_at(at, closed)
        # A dialect that fails in between is left out, and has no lengths.
        return next(iter(self._lengths(at, closed)), 0) if length == TIE else length

    def _follower(self, stop: int, closed: bool) -> int:
        """Say what stands at `stop`: `BOUNDARY`, the length of a frame (or `TIE`), 0 for something else, or `MORE`."""
        if self._base + stop in self._bursts:
            return BOUNDARY
        if stop < len(self._buffer):
            return self._look_at(stop, closed)
        return BOUNDARY if closed else MORE

    def _lengths(self, at: int, closed: bool) -> list[int]:
        """Return all lengths at which a frame checks here, ascending, and `MORE` behind them if there may be others."""
        buffer, end = self._buffer, len(self._buffer)
        found = {n for slicer in self._slicers.knowing[buffer[at]] for n in slicer.lengths(buffer, at, end)}
        wanting = MORE in found and not closed
        found.discard(MORE)
        return [*sorted(found), MORE] if wanting else sorted(found)

    def _is_firm(self, stop: int, closed: bool) -> bool:
        """Say whether the bytes before `stop` end at a boundary that is no mere pause."""
        return self._base + stop in self._firm or (closed and stop == len(self._buffer))

    def _spans(self, at: int, length: int) -> bool:
        """Say whether a boundary lies within these bytes."""
        first = self._base + at
        return any(first < b < first + length for b in self._bursts)

    def _skip(self, at: int) -> int:
        """Return the next place where a frame may begin, a burst does, or a piece of junk is full."""
        # Noise is searched a piece at a time, or a long stretch of it would be searched again for each piece.
        limit = min(len(self._buffer), self._junk_from + JUNK_PIECE)
        found = self.starts.search(self._buffer, at + 1, limit)
        target = found.start() if found else limit
        for burst in self._bursts:
            if burst > self._base + at:
                target = min(target, burst - self._base)
                break
        return target

    def _places_in(self, at: int, stop: int) -> Iterator[int]:
        return places_in(self.starts, self._buffer, at, stop)

    def _reach_burst(self) -> Iterator[Junk]:
        """Forget the boundaries passed; at one, junk ends and the framer is in step."""
        offset = self._base + self._at
        bursts = self._bursts
        while bursts and bursts[0] < offset:
            self._firm.discard(bursts.popleft())
        if bursts and bursts[0] == offset:
            self._step = offset
            yield from self._drop_junk()

    # --- weighing: each returns the length to take, 0 for none, or MORE --------------------------------------------

    def _settled(self, at: int, closed: bool) -> int:
        """Choose between two lengths one apart that both check.

        A frame behind one of them decides, then the open request, then a boundary; else it is the longer.
        """
        lengths = [n for n in self._lengths(at, closed) if n != MORE]
        tied = next(([a, b] for a, b in pairwise(lengths) if b == a + 1), None)
        if tied is None:
            return 0
        followers = [self._follower(at + n, closed) for n in tied]
        if MORE in followers:
            return MORE
        framed = [n for n, f in zip(tied, followers, strict=True) if f not in (0, BOUNDARY)]
        if len(framed) == 1:
            return framed[0]
        for slicer in self._slicers.knowing[self._buffer[at]]:
            preferred = slicer.preferred(self._buffer, at, tied)
            if preferred:
                return preferred
        bounded = [n for n, f in zip(tied, followers, strict=True) if f]
        return bounded[0] if len(bounded) == 1 else tied[1]

    def _doubtful(self, at: int, length: int, closed: bool) -> int:
        """Weigh a frame that checks where something else follows.

        Three things speak against it. A longer frame begins here and is followed: then that one is taken. A frame begins
        inside it and is followed, or ends beyond it: then this is the rest of a frame that lost bytes, and it checks by
        chance with the next frame's head. And `_or_inserted` finds something. A strong check is believed against all but
        the followed ones.
        """
        stop = at + length
        for longer in self._lengths(at, closed):
            if longer == MORE:
                return MORE
            if longer > length:
                follower = self._follower(at + longer, closed)
                if follower:
                    return MORE if follower == MORE else longer
        index = self._slicers.owner(self._buffer[at:stop])
        strong = self._slicers.each[index].strong_check
        for start in self._places_in(at + 1, stop):
            inner = self._shortest(start, closed)
            if inner == MORE:
                return MORE
            if not inner or start + inner == stop or self._spans(start, inner):
                continue
            follower = self._follower(start + inner, closed)
            if follower not in (0, MORE):
                follower = self._out_of_step(start, inner, closed)
            if follower:
                return MORE if follower == MORE else 0
            if start + inner > stop and not strong:
                inside = self._buffer[start : start + inner]
                if self._slicers.plausible(inside, self._slicers.owner(inside)):
                    return 0
        return length if strong else self._or_inserted(at, length, index, closed)

    def _or_inserted(self, at: int, length: int, index: int, closed: bool) -> int:
        """Weigh a doubtful frame against the same with one byte more, of which one was inserted.

        Both readings fit where leaving out a byte makes a frame that checks with the last one. A byte made by a pulse
        on an idle line is more likely a glitch behind a frame. So is the last byte, repeated. Else neither is likelier,
        and nothing is claimed.
        """
        stop = at + length + 1
        if stop > len(self._buffer):
            return length if closed else MORE
        follower = self._follower(stop, closed)
        if follower == MORE:
            return MORE
        slicer, plausible = self._slicers.each[index], self._slicers.plausible
        data = self._buffer[at:stop]
        glitch = data[-1] in GLITCHES or data[-1] == data[-2]
        if not follower or (glitch and plausible(data[:-1], index)):
            return length
        for place in range(1, length):
            mended = data[:place] + data[place + 1 :]
            if slicer.look(mended, 0, length, True) == length and plausible(mended, index):
                return 0
        return length

    def _out_of_step(self, at: int, length: int, closed: bool) -> int:
        """Weigh a frame behind junk, or inside another, that is followed.

        A row of frames inside it shows that a byte of junk looks like a package's head, and that the sum fits by chance.
        """
        for start in self._places_in(at + 1, at + length):
            inner = self._shortest(start, closed)
            if inner == MORE:
                return MORE
            if inner and start + inner < at + length:
                follower = self._follower(start + inner, closed)
                if follower not in (0, BOUNDARY):
                    return MORE if follower == MORE else 0
        return length

    def _wrecked(self, at: int, closed: bool) -> tuple[int, bool]:
        """Find a frame where none checks by its code: foreign, damaged, short. Return also whether its check counts."""
        buffer, end = self._buffer, len(self._buffer)
        offset = self._base + at
        known = self._slicers.knowing[buffer[at]]
        if known and self._bursts and self._bursts[0] == offset:
            ends = len(self._bursts) > 1
            burst = self._bursts[1] - offset if ends else end - at
            if burst <= self._slicers.longest:
                if not ends and not closed:
                    return MORE, False
                stop = at + burst
                firm = self._is_firm(stop, closed)
                fits = any(s.whole(buffer[at:stop]) and (firm or s.foreign(buffer, at)) for s in known)
                looks = self._slicers.looks
                if fits and not any(looks[buffer[n]](buffer, n, stop, True) for n in self._places_in(at + 1, stop)):
                    return burst, True
        for slicer in known:
            if slicer.strong_head or offset == self._step:
                for length in slicer.damaged(buffer, at, end):
                    follower = self._alone(at, length, closed)
                    if follower:
                        return (MORE if follower == MORE else length), False
        for slicer in known:
            for length in slicer.shortened(buffer, at, end):
                follower = self._alone(at, length, closed)
                if follower:
                    return (MORE if follower == MORE else length), self._is_firm(at + length, closed)
        return 0, False

    def _alone(self, at: int, length: int, closed: bool) -> int:
        """Say what follows these bytes, as `_follower` does; 0 also where a frame begins inside them."""
        if length == MORE:
            return 0 if closed else MORE
        if self._spans(at, length):
            return 0
        follower = self._follower(at + length, closed)
        if follower in (0, MORE):
            return follower
        for start in self._places_in(at + 1, at + length):
            inner = self._look_at(start, closed)
            if inner:
                return MORE if inner == MORE else 0
        return follower

    # --- what is given away ---------------------------------------------------------------------------------------

    def _drop_junk(self) -> Iterator[Junk]:
        """Give the junk away, by its reasons."""
        start, stop = self._junk_from, self._at
        if stop <= start:
            return
        offset = self._base + start
        for part, reason in self.reasons.parts(self._buffer[start:stop]):
            first_ns, last_ns = self._times(offset, offset + len(part))
            offset += len(part)
            self._junk_from += len(part)
            yield Junk(self.port, first_ns, last_ns, offset - len(part), part, reason)

    def _times(self, start: int, stop: int) -> tuple[int, int]:
        """Return the times of the first and the last byte, each from the chunk that brought it."""
        marks = self._marks
        while marks[0].stop <= start:
            marks.popleft()
        return self._time_of(start), self._time_of(stop - 1)

    def _time_of(self, offset: int) -> int:
        """Return the time of one byte: that of its chunk less the bytes behind it, not before the chunk before."""
        mark = next(m for m in self._marks if offset < m.stop)
        return max(mark.before_ns, mark.t_ns - (mark.stop - 1 - offset) * self._byte_ns)
