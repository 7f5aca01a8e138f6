"""Which frames of a block are plain exchanges: a request that is in order, and the reply that ends it.

Theory of operation. Identifier, length and code of a frame say its kind: which lanes it can have, as for single frames. A frame
can be a request, a reply, or, where the two look alike, either. Two frames of one drive that follow each other are a plain
exchange under three conditions: the first can be a request, the second a final reply to that command, and nothing is wrong
with the two. On CAN, exchanges of several drives may interleave. On a serial line the reply stands right behind its request,
which on some links alone tells what the reply is.

Rows that are all plain, and in which each exchange that begins ends, are a run. A run is passed on whole as far as no open
request has to do with it: until one would be given up, and but for drives that still wait for a reply. All other frames go
one by one, in their order.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from inspect import unwrap
from itertools import repeat

import msgspec
import numpy as np
from numpy.typing import NDArray

from analyzer.catalogue import Command, Dialect, Role
from analyzer.columns.block import DIRECTIONS, CanBlock, FrameBlock, Head
from analyzer.columns.codec import Bytes, ColumnCodec, Flags, Integers, column_codec
from analyzer.columns.groups import groups, numbered, ranks, taken, words
from analyzer.columns.plain import Plain
from analyzer.context import Request, RequestOutcome, State
from analyzer.link import Link
from analyzer.link.can import CanLink
from analyzer.port import Port
from analyzer.records import Frame, Lane, Message
from analyzer.transactions import meaning_of

#: Fewer frames than this are passed on faster one by one.
SHORTEST_RUN = 24
#: A block of which less than this is in runs goes one by one: runs cost the columns of the whole block.
LEAST_SHARE = 0.25
#: Frames that are passed on one by one after a run that what is known of the drives forbids.
AFTER_REFUSAL = 32
#: Times that exchanges are left out because one that was left out stands within; more would be of no use.
_ROUNDS = 4
#: Bytes by which a link says how many tell what a frame is.
_FEW = 3
#: Every second byte of a word; and by what four numbers in its pairs of bytes are multiplied to have their sum in the highest.
_EVEN, _EACH_PAIR = np.uint64(0x00FF00FF00FF00FF), np.uint64(0x0001000100010001)
_UNKNOWN, _REQUEST, _REPLY = range(len(DIRECTIONS))
#: How many values one byte can have.
_BYTES = 256


class _Kind(msgspec.Struct, frozen=True):
    """What frames of one identifier, length and code can be: places of lanes, as requests and as replies.

    `start`, `stop`: where the command's own data stand. `address`: of the drive, -1 where there is no lane.
    """

    asking: tuple[int, ...] = ()
    telling: tuple[int, ...] = ()
    start: int = 0
    stop: int = 0
    address: int = -1


class _Tables:
    """What frames of each kind can be, as arrays.

    `said`: by part, kind and byte of data, see `Pairing.say`; part 0 is the request, the others are replies.
    """

    def __init__(self, pairing: Pairing, kinds: Sequence[_Kind], said: Sequence[Sequence[NDArray[np.int8]]]) -> None:
        parts = 1 + max(len(kind.telling) for kind in kinds)
        self.starts = np.array([kind.start for kind in kinds])
        self.addresses = np.array([kind.address for kind in kinds])
        #: Numbers of the drives, short ones, by which rows are sorted fast.
        self.drives = np.unique(self.addresses, return_inverse=True)[1].astype(np.uint16)
        self.said = np.zeros((parts, len(kinds), 256), dtype=np.int8)
        self.asking = _padded([kind.asking for kind in kinds])
        self.telling = _padded([kind.telling for kind in kinds])
        #: Kinds whose data are read alike have one number; 0: what their one byte says stands in the table.
        self.readings = np.zeros(len(kinds), dtype=np.int64)
        self.examples: list[_Kind] = []
        known: dict[object, int] = {}
        for number, (kind, own) in enumerate(zip(kinds, said, strict=True)):
            if own:
                self.said[: len(own), number] = own
                continue
            self.readings[number] = known.setdefault(pairing.reading(kind), len(known) + 1)
            if len(known) > len(self.examples):
                self.examples.append(kind)


def _padded(lanes: Sequence[tuple[int, ...]]) -> Integers:
    """Return places of lanes as an array, a row for each kind."""
    most = max(1, *map(len, lanes)) if lanes else 1
    return np.array([[*own, *[-1] * (most - len(own))] for own in lanes], dtype=np.int64)


class Pairing:
    """Finds the plain exchanges in the blocks of one bus."""

    def __init__(self, port: Port, dialect: Dialect, late_ns: int) -> None:
        #: What was looked at last.
        self.block: CanBlock | FrameBlock | None = None
        self._port = port
        self._late_ns = late_ns
        self._dialect = dialect
        self._decoder = port.decoders[dialect.name]
        self._lanes: list[Lane] = []
        #: Of each lane the identifier of its frames; None where frames have none.
        self._identifiers: dict[Lane, int | None] = {}
        #: By identifier, length, first bytes and what was asked before: places in `_kinds`.
        self._known: dict[tuple[Head, int | None], int] = {}
        #: The first is that of all frames without a lane: there are as many heads of such as one likes.
        self._kinds = [_Kind()]
        #: Of each kind whose data are one byte at most, or say the same whatever they are: what each byte says, by part.
        self._said: list[tuple[NDArray[np.int8], ...]] = [(np.zeros(_BYTES, dtype=np.int8),)]
        self._said_by_reading: dict[object, tuple[NDArray[np.int8], ...]] = {}
        self._tables: _Tables | None = None
        #: Of each lane the number of its command and drive; requests that no drive answers have none, -1.
        self._exchanges: list[int] = []
        self._exchange_numbers: dict[tuple[int, int], int] = {}

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

    def look(self, block: CanBlock | FrameBlock, offsets: Integers) -> Plain:
        """Return what is plain in the next block. `offsets`: bytes of the bus before each frame."""
        self.block, count = block, len(block)
        requests, replies, lane = self._exchanges_of(block)
        used = np.flatnonzero(np.bincount(lane + 1, minlength=len(self._lanes) + 1)[1:])
        places = np.full(len(self._lanes) + 1, -1, dtype=np.int64)
        places[used] = np.arange(len(used))
        behind, latencies = np.zeros((2, count), dtype=np.int64)
        behind[replies] = replies - requests
        if block.timed:
            latencies[replies] = block.first_ns[replies] - block.t_ns[requests]
        lanes = tuple(self._lanes[n] for n in used.tolist())
        self._plain = Plain(self._dialect, block, lanes, places[lane], offsets, behind, latencies)
        # Between two rows may be cut where no exchange is open.
        self._asks = np.zeros(count, dtype=np.bool_)
        self._asks[requests] = True
        change = self._asks.astype(np.int64)
        change[replies] -= 1
        self._cuts = np.flatnonzero(np.concatenate(([0], np.cumsum(change))) == 0)
        edges = np.diff(np.concatenate(([0], (lane >= 0).astype(np.int8), [0])))
        starts = self._cuts[self._cuts.searchsorted(np.flatnonzero(edges > 0))]
        stops = self._cuts[self._cuts.searchsorted(np.flatnonzero(edges < 0), side="right") - 1]
        long = stops - starts >= SHORTEST_RUN
        self._starts, self._stops = starts[long], stops[long]
        if (self._stops - self._starts).sum() < LEAST_SHARE * count:
            self._starts = self._stops = starts[:0]
        return self._plain

    def next_run(self, at: int, end: int) -> tuple[int, int]:
        """Return where the next run from a row on begins and ends, as far as `end`; `end` twice where there is none."""
        for place in range(int(self._stops.searchsorted(at, side="right")), len(self._stops)):
            # A run that was begun one by one, or is cut short, begins and ends where no exchange is open.
            start = int(self._cuts[self._cuts.searchsorted(max(at, int(self._starts[place])))])
            stop = int(self._cuts[self._cuts.searchsorted(min(end, int(self._stops[place])), side="right") - 1])
            if start >= end:
                break
            if stop - start >= SHORTEST_RUN:
                return start, stop
        return end, end

    def take(self, start: int, stop: int, sequence: int) -> int:
        """Tell the bus of as many exchanges of a run as can be passed on whole. Return where they end.

        `sequence`: number of the first frame.
        """
        context, transactions, plain = self._port.context, self._port.transactions, self._plain
        if context.borrowed or not transactions.may_follow(plain.data(start)):
            return start
        own = plain.lane[start:stop]
        refused = self._refused(np.flatnonzero(np.bincount(own)).tolist())
        allowed = ~np.isin(own, refused) if refused else np.ones(stop - start, dtype=np.bool_)
        if context.echoes:
            # On a bus that may echo, a reply that repeats its request can be one.
            allowed &= ~self._repeated[start:stop]
        frames = len(allowed) if allowed.all() else int(allowed.argmin())
        until_ns = transactions.patient_until_ns()
        if until_ns is not None:
            frames = min(frames, int(plain.block.t_ns[start:stop].searchsorted(until_ns, side="right")))
        stop = int(self._cuts[self._cuts.searchsorted(start + frames, side="right") - 1])
        if stop > start:
            self._tell(start, stop, sequence)
        return stop

    def _tell(self, start: int, stop: int, sequence: int) -> None:
        plain = self._plain
        asks = self._asks[start:stop]
        row = stop - 1 - int(asks[::-1].argmax())
        lane = plain.lanes[plain.lane[row]]
        request = Request(plain.frame(row), lane.address, lane.command, sequence + row - start, lane.topic)
        request.lane, request.state, request.outcome = lane, State.DONE, RequestOutcome.ANSWERED
        rows = start + np.flatnonzero(~asks)
        addresses = np.array([lane.address for lane in plain.lanes])
        newest = np.full(int(addresses.max()) + 1, -1, dtype=np.int64)
        newest[addresses[plain.lane[rows]]] = rows
        replies = {address: plain.data(int(newest[address])) for address in np.flatnonzero(newest >= 0).tolist()}
        ended = (plain.lanes[n] for n in np.flatnonzero(np.bincount(plain.lane[rows])).tolist())
        moved = {lane.address for lane in ended if lane.command.silenced}
        self._port.transactions.were_answered(request, plain.frame(stop - 1), replies, moved, plain.block.t_ns[start:stop])

    def _refused(self, numbers: Sequence[int]) -> list[int]:
        """Return which of some lanes may not be plain."""
        usual: dict[tuple[int, int | None], bool] = {}
        refused = []
        for number in numbers:
            lane = self._plain.lanes[number]
            drive = lane.address, self._identifiers[lane]
            known = usual.get(drive)
            if known is None:
                # Nothing is known of most drives that would forbid any command.
                known = usual[drive] = self._is_usual(*drive)
            if not known and not self._allowed(lane):
                refused.append(number)
        return refused

    def _is_usual(self, address: int, identifier: int | None) -> bool:
        context = self._port.context
        known = identifier is None or identifier in self._port.nodes.drives
        speaks = context.speaks.get(address, self._dialect.name) == self._dialect.name
        return known and speaks and not any(address in each for each in (context.groups, context.silenced, context.open))

    def _allowed(self, lane: Lane) -> bool:
        """Say whether what is known of the drives lets frames of a lane be plain."""
        context, address, command = self._port.context, lane.address, lane.command
        identifier, open_ = self._identifiers[lane], context.open.get(address)
        if identifier is not None and identifier not in self._port.nodes.drives:
            return False
        if address in context.groups or context.speaks.get(address, lane.dialect) != lane.dialect:
            return False
        if command.silenced and address in context.silenced:
            return False
        if open_ is None:
            return True
        # Where the request decides what its reply is, another open request could decide otherwise.
        return bool(self._dialect.link.deciding_bytes) and all(
            # A command that is still executing takes no reply of another code; a waiting request is overtaken by any.
            other.state is State.RUNNING
            and not command.moves
            and other.command is not None
            and not _share(command, other.command)
            for other in open_
        )

    # --- what each frame can be -----------------------------------------------------------------------------------

    def _exchanges_of(self, block: CanBlock | FrameBlock) -> tuple[Integers, Integers, Integers]:
        """Return the rows of requests that are answered, those of their replies, and the lane of each row, -1 for none."""
        kinds, said, tables = self._said_by(block)
        sound = self._checked(block)
        chosen = said[0]
        good = (chosen > 0) & (chosen & 1 == 0) & sound & (block.directions != _REPLY)
        numbers = kinds * tables.asking.shape[1] + ((chosen - 1) >> 1)
        requests = np.where(good, tables.asking.reshape(-1).take(numbers, mode="clip"), -1)
        self._repeated = repeated = np.zeros(len(block), dtype=np.bool_)
        repeated[1:] = block.sizes[1:] == block.sizes[:-1]
        for word in words(block.data).T:
            repeated[1:] &= word[1:] == word[:-1]
        if isinstance(block, CanBlock):
            repeated[1:] &= (block.ids[1:] == block.ids[:-1]) | (tables.addresses.take(kinds[1:]) == block.ids[:-1])
            # Frames of one drive follow each other here; of those that are of none, it does not matter.
            order = np.argsort(tables.drives.take(kinds), kind="stable")
        else:
            order = np.arange(len(block))
        before, after = order[:-1], order[1:]
        exchanges = np.array([*self._exchanges, -1])
        apart = repeated.take(before)
        if isinstance(block, FrameBlock):
            apart = apart | (block.starts[1:] != block.starts[:-1] + block.sizes[:-1])
        asked = np.where(apart, -1, exchanges.take(requests.take(before), mode="wrap"))
        if not self._dialect.link.deciding_bytes:
            asked_before = np.full(len(block), -1, dtype=np.int64)
            asked_before[after] = asked
            kinds, said, tables = self._said_by(block, asked_before)
            exchanges = np.array([*self._exchanges, -1])
        replies = np.full(len(after), -1, dtype=np.int64)
        open_ = np.flatnonzero(asked >= 0)
        rows = after.take(open_)
        in_time = block.t_ns.take(rows) - block.t_ns.take(before.take(open_)) <= self._late_ns
        open_ = open_[in_time & sound.take(rows) & (block.directions.take(rows) != _REQUEST)]
        for part in range(1, len(said)):
            # The first reply to the command that matches is the one; then its values are looked at.
            rows = after.take(open_)
            says = said[part].take(rows)
            lanes = tables.telling[:, part - 1].take(kinds.take(rows))
            fits = (says > 0) & (exchanges.take(lanes, mode="wrap") == asked.take(open_))
            replies[open_] = np.where(fits & (says & 1 == 0), lanes, -1)
            open_ = open_[~fits]
        places = _first_of_two(np.flatnonzero(replies >= 0))
        asking, telling = before.take(places), after.take(places)
        lane = np.full(len(block), -1, dtype=np.int64)
        lane[asking], lane[telling] = requests.take(asking), replies.take(places)
        for _ in range(_ROUNDS):
            # An exchange with another frame within goes one by one, so that the others around it need not.
            others = np.concatenate(([0], np.cumsum(lane < 0)))
            crossed = others.take(telling) > others.take(asking)
            if not crossed.any():
                break
            lane[asking[crossed]] = lane[telling[crossed]] = -1
            asking, telling = asking[~crossed], telling[~crossed]
        return asking, telling, lane

    def _said_by(
        self, block: CanBlock | FrameBlock, asked: Integers | None = None
    ) -> tuple[Integers, list[NDArray[np.int8]], _Tables]:
        """Return the kind of each row, and what its data say of each part.

        `asked`: the number of the exchange that the row before asks for, -1 for none; None: replies need no request to be told,
        or only requests are looked for.
        """
        numbers, widths = self._alike(block)
        if asked is not None:
            numbers = ranks(numbers)[1].astype(np.int64) * (len(self._exchange_numbers) + 1) + asked + 1
        alike, at = ranks(numbers)
        examples = np.empty(len(alike), dtype=np.int64)
        examples[at] = np.arange(len(at))
        numbers = np.empty(len(alike), dtype=np.int64)
        heads = block.heads(examples, widths if isinstance(widths, int) else widths.take(examples))
        before = repeat(None) if asked is None else asked.take(examples).tolist()
        for number, head in enumerate(zip(heads, before, strict=asked is not None)):
            known = self._known.get(head)
            if known is None:
                known = self._known[head] = self._new_kind(block, int(examples[number]), head[1])
            numbers[number] = known
        tables = self._tables = self._tables or _Tables(self, self._kinds, self._said)
        kinds = numbers.take(at)
        width = block.data.shape[1]
        starts = np.minimum(tables.starts, width - 1)
        bytes_ = block.data.reshape(-1).take(np.arange(0, width * len(block), width) + starts.take(kinds))
        entries = kinds * 256 + bytes_
        said = [part.reshape(-1).take(entries) for part in tables.said]
        for number, rows in groups(tables.readings.take(kinds)) if tables.examples else ():
            for part, own_said in enumerate(self.say(tables.examples[number - 1], taken(block.data, rows))):
                said[part][rows] = own_said
        return kinds, said, tables

    def _alike(self, block: CanBlock | FrameBlock) -> tuple[Integers, Integers | int]:
        """Return numbers that are the same where all is that tells what a frame is, and how many first bytes those are."""
        link = self._dialect.link
        if link.deciding_bytes:
            return block.alike(link.deciding_bytes), link.deciding_bytes
        # Frames of one length and the same first bytes have as many.
        alike, at = ranks(numbers := block.alike(_FEW))
        examples = np.empty(len(alike), dtype=np.int64)
        examples[at] = np.arange(len(at))
        told = [link.deciding(block.frame_of(row, self._dialect, 0).data) for row in examples.tolist()]
        widths = np.array(told, dtype=np.int64)[at]
        more = block.data[:, _FEW : max(told)]
        return numbered(more * (np.arange(_FEW, _FEW + more.shape[1]) < widths[:, None]), numbers), widths

    def _new_kind(self, block: CanBlock | FrameBlock, row: int, asked: int | None) -> int:
        """Return the place of the kind of a frame, which none before had."""
        kind = _Kind()
        if block.sizes[row] <= block.data.shape[1]:
            kind = self._kind(block.frame_of(row, self._dialect, 0), asked)
        if not kind.asking and not kind.telling:
            return 0
        self._kinds.append(kind)
        few = kind.stop - kind.start <= 1 or self._says_the_same(kind)
        self._said.append(self._say_every(kind, block.data.shape[1]) if few else ())
        self._tables = None
        return len(self._kinds) - 1

    def _says_the_same(self, kind: _Kind) -> bool:
        """Say whether the data of frames cannot change what a kind says."""
        lanes = [self._lanes[n] for n in (*kind.asking, *kind.telling)]
        judged = any(self._lanes[n].command.judged for n in kind.telling)
        return not judged and all(column_codec(lane.form.layout, kind.start).takes_all for lane in lanes)

    def _say_every(self, kind: _Kind, width: int) -> tuple[NDArray[np.int8], ...]:
        """Return what each byte of data says, for frames of a kind that have one at most; kinds that read alike share it."""
        reading = self.reading(kind)
        if reading not in self._said_by_reading:
            every: Bytes = np.zeros((_BYTES, width), dtype=np.uint8)
            every[:, kind.start : kind.start + 1] = np.arange(_BYTES)[:, None]
            self._said_by_reading[reading] = tuple(self.say(kind, every))
        return self._said_by_reading[reading]

    def _kind(self, frame: Frame, asked: int | None) -> _Kind:
        """Return what frames like this one can be. `asked`: what a reply can answer; None: anything, or it is a request."""
        link = self._dialect.link
        if frame.can is not None and self._port.describes(frame.can) is not None:
            return _Kind()
        lanes: tuple[list[int], list[int]] = [], []
        start = stop = 0
        address = -1
        for lane in self._decoder.lanes(frame) if link.deciding(frame.data) else ():
            if not ColumnCodec.fits(lane.form.layout) or lane.command.borrows:
                continue
            if not lane.is_request and lane.command.changes_answers:
                continue
            own = id(lane.command), lane.address
            answered = not lane.is_request or lane.plain
            exchange = self._exchange_numbers.setdefault(own, len(self._exchange_numbers)) if answered else -1
            if not link.deciding_bytes and (asked is not None if lane.is_request else exchange != asked):
                continue
            lane.topic = self._port.topic_of(lane.address, lane.command, lane.role)
            start, stop, address = lane.start, lane.stop, lane.address
            lanes[not lane.is_request].append(len(self._lanes))
            self._lanes.append(lane)
            self._identifiers[lane] = link.identifier(lane.command, lane.address)
            self._exchanges.append(exchange)
        return _Kind(tuple(lanes[0]), tuple(lanes[1]), start, stop, address)

    def reading(self, kind: _Kind) -> object:
        """Return what kinds have in common whose data say the same."""
        lanes = [self._lanes[n] for n in (*kind.asking, *kind.telling)]
        return kind.start, kind.stop, len(kind.asking), tuple((id(lane.form), id(lane.command)) for lane in lanes)

    def say(self, kind: _Kind, data: Bytes) -> Iterator[NDArray[np.int8]]:
        """Yield a code for each frame: first what request it is, then, for each possible reply, whether it is that one.

        Request: 0 none, 2 n + 1 the n-th possible one, 2 n + 2 the same and in order. Reply: 0 no, 1 yes, 2 yes, and it ends
        its exchange well.
        """
        said = np.zeros(len(data), dtype=np.int8)
        for place, number in enumerate(kind.asking):
            codec = column_codec(self._lanes[number].form.layout, kind.start)
            # The first that matches is the frame's lane, even if its values are then found wrong.
            said = np.where((said == 0) & codec.matches(data), 2 * place + 1 + codec.valid(data), said).astype(np.int8)
        yield said
        for number in kind.telling:
            lane = self._lanes[number]
            codec = column_codec(lane.form.layout, kind.start)
            matches = codec.matches(data)
            good = matches & codec.valid(data)
            if lane.command.judged:
                good[good] = self._final(lane, data[good, kind.start : kind.stop])
            yield (matches.astype(np.int8) + good).astype(np.int8)

    def _checked(self, block: CanBlock | FrameBlock) -> Flags:
        link = self._dialect.link
        if isinstance(block, FrameBlock):
            # Found by their checks; what is too long for a row is left out.
            short: Flags = block.sizes <= block.data.shape[1]
            return short
        if not link.checked:
            fits: Flags = np.ones(len(block), dtype=np.bool_)
        elif unwrap(type(link).fits) is CanLink.fits and not link.left_out:
            last = block.data.reshape(-1)[np.arange(0, 8 * len(block), 8) + np.maximum(block.sizes - 1, 0)]
            # All bytes and the identifier, of which the low byte counts, without the check itself.
            word = words(block.data)[:, 0]
            pairs = (word & _EVEN) + (word >> np.uint64(8) & _EVEN)
            total = (pairs * _EACH_PAIR >> np.uint64(48)).astype(np.uint8) + block.ids.astype(np.uint8) - last
            fits = total == last
        else:
            fits = np.array([link.fits(frame.data, frame.id) for frame in block.frames()], dtype=np.bool_)
        return fits & (block.sizes >= link.shortest)

    def _final(self, lane: Lane, own: Bytes) -> Flags:
        """Say of each reply whether it ends its exchange well."""
        if not len(own):
            return np.zeros(0, dtype=np.bool_)
        unique, places = np.unique(own, axis=0, return_inverse=True)
        told = []
        for data in map(bytes, unique):
            frame = Frame(self._port.name, 0, 0, 0, data, self._dialect, Role.REPLY, True)
            message = Message(frame, lane.role, lane.address, lane.command, lane.form, data)
            told.append(meaning_of(message, lane.command)[0] == "final")
        result: Flags = np.array(told, dtype=np.bool_)[places.reshape(-1)]
        return result


def _share(command: Command, other: Command) -> bool:
    """Say whether the replies to two commands can have one code."""
    return not _reply_codes(command).isdisjoint(_reply_codes(other))


def _reply_codes(command: Command) -> set[int | None]:
    return {command.code if form.code is None else form.code for form in command.reply_forms}


def _first_of_two(pairs: Integers) -> Integers:
    """Return where exchanges begin that do not overlap: of rows that follow each other, the first, the third and so on."""
    follows = np.zeros(len(pairs), dtype=np.bool_)
    np.equal(pairs[1:], pairs[:-1] + 1, out=follows[1:])
    if not follows.any():
        return pairs
    places = np.arange(len(pairs))
    begins = np.maximum.accumulate(np.where(follows, 0, places))
    result: Integers = pairs[(places - begins) & 1 == 0]
    return result
