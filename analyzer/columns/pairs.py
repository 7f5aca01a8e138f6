"""Which frames of a block are plain exchanges: a request that is in order, and right behind it the reply that ends it.

Theory of operation. Identifier, length and code of a frame name its lanes, as for single frames. A frame can be a request,
a reply, or, where the two look alike, either. At row `i` a plain exchange begins under three conditions: row `i` can be a
request, row `i + 1` a final reply to that command, and nothing is wrong with the two. Exchanges that follow each other are
a run. A run is passed on whole as far as no open request has to do with it: until one would be given up, and but for drives
that still wait for a reply. All other frames go one by one, in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from analyzer.catalogue import Command, Dialect, Role
from analyzer.columns.block import DIRECTIONS, CanBlock
from analyzer.columns.codec import Bytes, ColumnCodec, Flags, Integers
from analyzer.columns.groups import groups, ranks
from analyzer.context import Request, RequestOutcome, State
from analyzer.link.can import CanLink
from analyzer.port import Port
from analyzer.records import Frame, Lane, Message
from analyzer.transactions import meaning_of

#: Fewer frames than this are passed on faster one by one.
SHORTEST_RUN = 64
#: A block of which less than this is in runs goes one by one: runs cost the columns of the whole block.
LEAST_SHARE = 0.25
#: Frames that are passed on one by one after a run that what is known of the drives forbids.
AFTER_REFUSAL = 32
_UNKNOWN, _REQUEST, _REPLY = range(len(DIRECTIONS))


@dataclass(frozen=True)
class Plain:
    """The frames of a block that are part of plain exchanges.

    `lanes`: those that occur; `lane`: of each row, a place in `lanes`, -1 where a frame is not plain. `offsets`: bytes of the
    bus before each frame. `first`: sequence number of the first row; the others count on from it. `before_ns`: time of the
    frame before the first, if it is known.
    """

    dialect: Dialect
    block: CanBlock
    lanes: tuple[Lane, ...]
    lane: Integers
    offsets: Integers
    first: int
    before_ns: int | None = None

    def frame(self, row: int) -> Frame:
        """Return one frame."""
        can = self.block.frame(row)
        t_ns = int(self.block.t_ns[row])
        return Frame(can.port, t_ns, t_ns, int(self.offsets[row]), can.data, self.dialect, can.direction, True, can)

    @cached_property
    def latencies(self) -> Integers:
        """The time from the frame before to each; not above 0: it is not known."""
        return np.diff(self.block.t_ns, prepend=self.block.t_ns[0] if self.before_ns is None else self.before_ns)

    def firsts(self, start: int, stop: int, wanted: Flags) -> list[int]:
        """Return the first row of each lane that is wanted and occurs in some rows, in their order."""
        own = self.lane[start:stop]
        numbers = np.flatnonzero(wanted & (np.bincount(own, minlength=len(wanted)) > 0))
        return sorted(start + int((own == number).argmax()) for number in numbers)

    def part(self, first: int, runs: Sequence[tuple[int, int]]) -> tuple[Plain, Integers]:
        """Return what is plain in some runs, with no other lanes, and the places of its lanes here.

        `runs`: from which row to which, counted from the row `first`, which begins the part. They follow each other.
        """
        rows = slice(first, first + runs[-1][1])
        lane = np.full(runs[-1][1], -1, dtype=np.int64)
        for start, stop in runs:
            lane[start:stop] = self.lane[first + start : first + stop]
        used = np.flatnonzero(np.bincount(lane + 1)[1:])
        places = np.full(len(self.lanes) + 1, -1, dtype=np.int64)
        places[used] = np.arange(len(used))
        lanes = tuple(self.lanes[n] for n in used.tolist())
        before_ns = int(self.block.t_ns[first - 1]) if first else self.before_ns
        block, offsets = self.block.part(rows), self.offsets[rows]
        return Plain(self.dialect, block, lanes, places[lane], offsets, self.first + first, before_ns), used


class Pairing:
    """Finds the plain exchanges in the blocks of one bus."""

    def __init__(self, port: Port, late_ns: int) -> None:
        self._port = port
        self._late_ns = late_ns
        self._dialect = port.can[0]
        self._decoder = port.decoders[self._dialect.name]
        self._lanes: list[Lane] = []
        #: By identifier, length and code: places in `_lanes` of what a frame can be, requests and replies.
        self._known: dict[int, tuple[list[int], list[int]]] = {}
        self._codecs: list[ColumnCodec] = []
        self._finals: list[dict[bytes, bool]] = []

    @staticmethod
    def serves(port: Port) -> bool:
        """Say whether blocks of a bus can be looked at: it has one dialect, whose frames name their lanes."""
        return len(port.can) == 1 and bool(port.can[0].link.deciding_bytes) and port.nodes.listed is None

    def is_of(self, port: Port) -> bool:
        """Say whether this was made for a bus as it is now."""
        return port is self._port and [self._dialect] == port.can and port.decoders[self._dialect.name] is self._decoder

    def look(self, block: CanBlock, first: int, offset: int) -> Plain:
        """Return what is plain in the next block: its first frame has the number `first` and `offset` bytes before it."""
        requests, replies = self._roles(block)
        begins = _first_of_two(self._pairs(block, requests, replies))
        lane = np.where(begins, requests, -1)
        lane[1:] = np.where(begins[:-1], replies[1:], lane[1:])
        used, places = ranks(lane + 1)
        used, places = (used[1:], places.astype(np.int64) - 1) if used[0] == 0 else (used, places.astype(np.int64))
        offsets = offset + np.cumsum(block.sizes) - block.sizes
        self._plain = Plain(self._dialect, block, tuple(self._lanes[n - 1] for n in used), places, offsets, first)
        edges = np.diff(np.concatenate(([0], (lane >= 0).astype(np.int8), [0])))
        starts, stops = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
        long = stops - starts >= SHORTEST_RUN
        self._starts, self._stops = starts[long], stops[long]
        if (self._stops - self._starts).sum() < LEAST_SHARE * len(lane):
            self._starts = self._stops = starts[:0]
        return self._plain

    def next_run(self, at: int) -> tuple[int, int]:
        """Return where the next run at or behind a row begins and ends; the end of the block twice where there is none."""
        count = len(self._plain.lane)
        place = int(np.searchsorted(self._stops, at, side="right"))
        if place == len(self._stops):
            return count, count
        start, stop = int(self._starts[place]), int(self._stops[place])
        # A run that was begun one by one goes on with its next request.
        start += max(0, -(-(at - start) // 2)) * 2
        return (start, stop) if start < stop else self.next_run(stop)

    def take(self, start: int, stop: int) -> int:
        """Tell the bus of as many exchanges of a run as can be passed on whole. Return where they end."""
        context, transactions, plain = self._port.context, self._port.transactions, self._plain
        if context.borrowed or not transactions.may_follow(plain.block.frame(start).data):
            return start
        own = plain.lane[start:stop]
        refused = [n for n in np.flatnonzero(np.bincount(own)).tolist() if not self._allowed(plain.lanes[n])]
        allowed = ~np.isin(own, refused) if refused else np.ones(stop - start, dtype=np.bool_)
        if context.echoes:
            # On a bus that may echo, a reply that repeats its request can be one.
            allowed &= ~self._repeated[start:stop]
        frames = len(allowed) if allowed.all() else int(allowed.argmin())
        until_ns = transactions.patient_until_ns()
        if until_ns is not None:
            frames = min(frames, int(plain.block.t_ns[start:stop].searchsorted(until_ns, side="right")))
        stop = start + frames // 2 * 2
        if stop > start:
            self._tell(start, stop)
        return stop

    def _tell(self, start: int, stop: int) -> None:
        plain = self._plain
        asked, told = plain.frame(stop - 2), plain.frame(stop - 1)
        lane = plain.lanes[plain.lane[stop - 2]]
        request = Request(asked, lane.address, lane.command, plain.first + stop - 2, lane.topic)
        request.lane, request.state, request.outcome = lane, State.DONE, RequestOutcome.ANSWERED
        addresses = np.array([lane.address for lane in plain.lanes])[plain.lane[start + 1 : stop : 2]]
        known, rows = np.unique(addresses[::-1], return_index=True)
        lasts = (stop - 1 - 2 * rows).tolist()
        replies = {a: plain.block.frame(row).data for a, row in zip(known.tolist(), lasts, strict=True)}
        ended = (plain.lanes[n] for n in np.unique(plain.lane[start + 1 : stop : 2]).tolist())
        moved = {lane.address for lane in ended if lane.command.silenced}
        self._port.transactions.were_answered(request, told, replies, moved, plain.block.t_ns[start:stop])

    def _allowed(self, lane: Lane) -> bool:
        """Say whether what is known of the drives lets frames of a lane be plain."""
        context, address, command = self._port.context, lane.address, lane.command
        return (
            self._dialect.link.identifier(command, address) in self._port.nodes.drives
            and address not in context.groups
            and not (command.silenced and address in context.silenced)
            and context.speaks.get(address, lane.dialect) == lane.dialect
            and all(
                # What a drive still does takes no reply of another code; a request that waits is overtaken by any.
                other.state is State.RUNNING
                and not command.moves
                and other.command is not None
                and not _share(command, other.command)
                for other in context.open.get(address, ())
            )
        )

    # --- what each frame can be -----------------------------------------------------------------------------------

    def _roles(self, block: CanBlock) -> tuple[Integers, Integers]:
        """Return the lane that each frame has as a request, and as a reply to the frame before it; -1: none."""
        ids, places = ranks(block.ids)
        # The rank of an identifier instead of itself: so keys are small numbers, of which groups are found fast.
        alike = groups(places.astype(np.int64) << 12 | block.sizes << 8 | block.data[:, 0])
        keyed = [(int(ids[key >> 12]) << 12 | key & 0xFFF, rows) for key, rows in alike]
        sound = self._checked(block)
        requests = np.full(len(block), -1, dtype=np.int64)
        replies = np.full(len(block), -1, dtype=np.int64)
        kinds = [(*self._kinds(key, block, int(rows[0])), rows) for key, rows in keyed]
        for asking, _, group in kinds:
            left = group[sound[group] & (block.directions[group] != _REPLY)]
            for number in asking:
                own = block.data[left, self._lanes[number].start : self._lanes[number].stop]
                matches = self._codecs[number].matches(own)
                # The first that matches is the frame's lane, even if its values are then found wrong.
                requests[left[matches & self._codecs[number].valid(own)]] = number
                left = left[~matches]
        for _, telling, group in kinds:
            rows = group[(group > 0) & sound[group] & (block.directions[group] != _REQUEST)]
            for number in telling:
                lane = self._lanes[number]
                asked = [n for n, each in enumerate(self._lanes) if each.is_request and self._asks(each, lane)]
                fitting = rows[np.isin(requests[rows - 1], asked)] if asked else rows[:0]
                own = block.data[fitting, lane.start : lane.stop]
                good = self._codecs[number].matches(own) & self._codecs[number].valid(own)
                if lane.command.judged:
                    good &= self._final(number, own)
                replies[fitting[good]] = number
        return requests, replies

    @staticmethod
    def _asks(request: Lane, reply: Lane) -> bool:
        return request.command is reply.command and request.address == reply.address and request.plain

    def _pairs(self, block: CanBlock, requests: Integers, replies: Integers) -> Flags:
        """Say of each row whether a plain exchange begins there."""
        pairs = np.zeros(len(block), dtype=np.bool_)
        if len(block) < 2:
            return pairs
        self._repeated = repeated = np.zeros(len(block), dtype=np.bool_)
        repeated[1:] = (block.sizes[1:] == block.sizes[:-1]) & (block.data[1:] == block.data[:-1]).all(axis=1)
        # The first row of a run is compared with the frame before it when the run is taken.
        pairs[:-1] = (requests[:-1] >= 0) & (replies[1:] >= 0) & (np.diff(block.t_ns) <= self._late_ns)
        result: Flags = pairs & ~repeated
        return result

    def _checked(self, block: CanBlock) -> Flags:
        link = self._dialect.link
        if not link.checked:
            fits: Flags = np.ones(len(block), dtype=np.bool_)
        elif type(link).fits is CanLink.fits:
            last = np.take_along_axis(block.data, np.maximum(block.sizes - 1, 0)[:, None], axis=1)[:, 0]
            total = block.ids + block.data.sum(axis=1, dtype=np.int64) - last
            fits = (total & 0xFF) == last
        else:
            fits = np.array([link.fits(frame.data, frame.id) for frame in block.frames()], dtype=np.bool_)
        return fits & (block.sizes >= link.shortest)

    def _kinds(self, key: int, block: CanBlock, row: int) -> tuple[list[int], list[int]]:
        known = self._known.get(key)
        if known is None:
            can = block.frame(row)
            frame = Frame(self._port.name, 0, 0, 0, can.data, self._dialect, Role.UNKNOWN, True, can)
            known = self._known[key] = ([], [])
            for lane in self._decoder.lanes(frame):
                if not ColumnCodec.fits(lane.form.layout) or lane.command.borrows:
                    continue
                if not lane.is_request and lane.command.changes_answers:
                    continue
                lane.topic = self._port.topic_of(lane.address, lane.command, lane.role)
                known[not lane.is_request].append(len(self._lanes))
                self._lanes.append(lane)
                self._codecs.append(ColumnCodec(lane.form.layout))
                self._finals.append({})
        return known

    def _final(self, number: int, own: Bytes) -> Flags:
        """Say of each reply whether it ends its exchange well."""
        lane, known = self._lanes[number], self._finals[number]
        if not len(own):
            return np.zeros(0, dtype=np.bool_)
        unique, places = np.unique(own, axis=0, return_inverse=True)
        told = []
        for data in map(bytes, unique):
            if data not in known:
                frame = Frame(self._port.name, 0, 0, 0, data, self._dialect, Role.REPLY, True)
                message = Message(frame, lane.role, lane.address, lane.command, lane.form, data)
                known[data] = meaning_of(message, lane.command)[0] == "final"
            told.append(known[data])
        result: Flags = np.array(told, dtype=np.bool_)[places.reshape(-1)]
        return result


def _share(command: Command, other: Command) -> bool:
    """Say whether the replies to two commands can have one code."""
    return not _reply_codes(command).isdisjoint(_reply_codes(other))


def _reply_codes(command: Command) -> set[int | None]:
    return {command.code if form.code is None else form.code for form in command.reply_forms}


def _first_of_two(pairs: Flags) -> Flags:
    """Return where exchanges begin that do not overlap: of rows that follow each other, the first, the third and so on."""
    rows = np.arange(len(pairs))
    before = np.concatenate(([False], pairs[:-1]))
    begin = np.maximum.accumulate(np.where(pairs & ~before, rows, 0))
    result: Flags = pairs & ((rows - begin) % 2 == 0)
    return result
