"""Which frames of a block are plain exchanges: a request that is in order, and right behind it the reply that ends it.

Theory of operation. Identifier, length and code of a frame name its lanes, as for single frames. A frame can be a request,
a reply, or, where the two look alike, either. At row `i` a plain exchange begins under three conditions: row `i` can be a
request, row `i + 1` a final reply to that command, and nothing is wrong with the two. Exchanges that follow each other are
a run. A run is passed on whole as far as no open request has to do with it: until one would be given up, and but for drives
that still wait for a reply. All other frames go one by one, in their order.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from inspect import unwrap

import numpy as np

from analyzer.catalogue import Command, Dialect, Role
from analyzer.columns.block import DIRECTIONS, WIDEST_ROW, CanBlock, FrameBlock
from analyzer.columns.codec import Bytes, ColumnCodec, Flags, Integers
from analyzer.columns.groups import groups, numbered, ranks
from analyzer.context import Request, RequestOutcome, State
from analyzer.link import Link
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
#: Bytes by which the link says how many tell what a frame is.
_FEW = 3
_UNKNOWN, _REQUEST, _REPLY = range(len(DIRECTIONS))


@dataclass(frozen=True)
class Plain:
    """The frames of a block that are part of plain exchanges.

    `lanes`: those that occur; `lane`: of each row, a place in `lanes`, -1 where a frame is not plain. `offsets`: bytes of the
    bus before each frame. `first`: sequence number of the first row; the others count on from it.
    """

    dialect: Dialect
    block: CanBlock | FrameBlock
    lanes: tuple[Lane, ...]
    lane: Integers
    offsets: Integers
    first: int

    def frame(self, row: int) -> Frame:
        """Return one frame."""
        return self.block.frame_of(row, self.dialect, int(self.offsets[row]))

    @cached_property
    def latencies(self) -> Integers:
        """The time from the frame before to each; not above 0: it is not known."""
        return self.block.waits_ns


class Pairing:
    """Finds the plain exchanges in the blocks of one bus."""

    def __init__(self, port: Port, dialect: Dialect, late_ns: int) -> None:
        self._port = port
        self._late_ns = late_ns
        self._dialect = dialect
        self._decoder = port.decoders[self._dialect.name]
        self._lanes: list[Lane] = []
        #: By identifier, length and first bytes: places in `_lanes` of what a frame can be, requests and replies.
        self._known: dict[tuple[int | None, int, bytes], tuple[list[int], list[int]]] = {}
        self._codecs: list[ColumnCodec] = []
        self._finals: list[dict[bytes, bool]] = []

    @staticmethod
    def dialect_of(port: Port, block: CanBlock | FrameBlock) -> Dialect | None:
        """Return the dialect that blocks of a bus can be looked at in: the only one, if its frames name their lanes."""
        spoken = port.can if isinstance(block, CanBlock) else port.serial
        if len(spoken) != 1 or port.nodes.listed is not None:
            return None
        link = spoken[0].link
        return spoken[0] if link.deciding_bytes or type(link).deciding is not Link.deciding else None

    def is_of(self, port: Port, dialect: Dialect) -> bool:
        """Say whether this was made for a bus as it is now."""
        return port is self._port and dialect is self._dialect and port.decoders[dialect.name] is self._decoder

    def look(self, block: CanBlock | FrameBlock, first: int, offset: int) -> Plain:
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
        if context.borrowed or not transactions.may_follow(plain.frame(start).data):
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
        replies = {a: plain.frame(row).data for a, row in zip(known.tolist(), lasts, strict=True)}
        ended = (plain.lanes[n] for n in np.unique(plain.lane[start + 1 : stop : 2]).tolist())
        moved = {lane.address for lane in ended if lane.command.silenced}
        self._port.transactions.were_answered(request, told, replies, moved, plain.block.t_ns[start:stop])

    def _allowed(self, lane: Lane) -> bool:
        """Say whether what is known of the drives lets frames of a lane be plain."""
        context, address, command = self._port.context, lane.address, lane.command
        identifier = self._dialect.link.identifier(command, address)
        return (
            (identifier is None or identifier in self._port.nodes.drives)
            and address not in context.groups
            and not (command.silenced and address in context.silenced)
            and context.speaks.get(address, lane.dialect) == lane.dialect
            and (bool(self._dialect.link.deciding_bytes) or address not in context.open)
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

    def _roles(self, block: CanBlock | FrameBlock) -> tuple[Integers, Integers]:
        """Return the lane that each frame has as a request, and as a reply to the frame before it; -1: none."""
        sound = self._checked(block)
        requests = np.full(len(block), -1, dtype=np.int64)
        replies = np.full(len(block), -1, dtype=np.int64)
        kinds = [(*self._kinds(block, int(rows[0])), rows) for rows in self._alike(block)]
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
                matches = self._codecs[number].matches(own)
                good = matches & self._codecs[number].valid(own)
                if len(telling) > 1:
                    # Of several forms of one reply, the first that matches counts.
                    rows = np.setdiff1d(rows, fitting[matches], assume_unique=True)
                if lane.command.judged:
                    good &= self._final(number, own)
                replies[fitting[good]] = number
        return requests, replies

    @staticmethod
    def _asks(request: Lane, reply: Lane) -> bool:
        return request.command is reply.command and request.address == reply.address and request.plain

    def _pairs(self, block: CanBlock | FrameBlock, requests: Integers, replies: Integers) -> Flags:
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

    def _checked(self, block: CanBlock | FrameBlock) -> Flags:
        link = self._dialect.link
        if isinstance(block, FrameBlock):
            # Found by their checks; what is too long for a row is left out.
            return block.sizes <= WIDEST_ROW
        if not link.checked:
            fits: Flags = np.ones(len(block), dtype=np.bool_)
        elif unwrap(type(link).fits) is CanLink.fits and not link.left_out:
            last = np.take_along_axis(block.data, np.maximum(block.sizes - 1, 0)[:, None], axis=1)[:, 0]
            total = block.ids + block.data.sum(axis=1, dtype=np.int64) - last
            fits = (total & 0xFF) == last
        else:
            fits = np.array([link.fits(frame.data, frame.id) for frame in block.frames()], dtype=np.bool_)
        return fits & (block.sizes >= link.shortest)

    def _alike(self, block: CanBlock | FrameBlock) -> Iterator[Integers]:
        """Yield the rows of each identifier, length and first bytes that tell what a frame is."""
        link = self._dialect.link
        few = link.deciding_bytes or _FEW
        for _, rows in groups(block.alike(few)):
            more = 0 if link.deciding_bytes else link.deciding(block.frame_of(int(rows[0]), self._dialect, 0).data)
            if more <= few:
                yield rows
            else:
                yield from (rows[own] for _, own in groups(numbered(block.data[rows, few:more])))

    def _kinds(self, block: CanBlock | FrameBlock, row: int) -> tuple[list[int], list[int]]:
        frame, link = block.frame_of(row, self._dialect, 0), self._dialect.link
        key = None if frame.can is None else frame.can.id, len(frame.data), frame.data[: link.deciding(frame.data)]
        known = self._known.get(key)
        if known is None:
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
