"""Each request with all that came back before the next one, as a person reads a log.

The pipeline pairs sound frames alone. Here bytes stay as they were read. So a reply is found in two reads, in a later read, or
behind another request than its own.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from functools import lru_cache
from typing import NamedTuple

from analyzer.catalogue import Role
from analyzer.diagnosis.scene import Piece, Scene, Stretch
from analyzer.link import FUNCTIONS, READS, Link
from analyzer.records import Message

#: Requests back that a reply is looked for.
_BACK = 8
#: Exchanges that are looked at: more of the same shows nothing new.
_MOST = 2000
#: The shortest Modbus request without its CRC, and eModbus's codes of errors in a reply.
_BARE, _CODES = 6, range(0xE0, 0xE6)
#: Writes of the standard, which are answered by what they begin with.
_WRITES, _WRITTEN = (0x05, 0x06, 0x0F, 0x10), 6


class Turn(NamedTuple):
    """Bytes of one sender, as the host wrote or read them at once. `message`: the frame that they are."""

    offset: int
    data: bytes
    t_ns: int
    role: Role
    message: Message | None
    piece: Piece | None

    @property
    def stop(self) -> int:
        """Where the bytes end on the bus."""
        return self.offset + len(self.data)


class Exchange(NamedTuple):
    """A request and what came back before the next one."""

    request: Turn
    received: list[Turn]

    @property
    def data(self) -> bytes:
        """All that came back."""
        return b"".join(turn.data for turn in self.received)


class Awaited(NamedTuple):
    """How a reply begins, and how long it is."""

    head: bytes
    size: int
    link: Link

    def stands(self, data: bytes, at: int) -> bool:
        """Say whether the whole reply stands there and its check fits."""
        stop = at + self.size
        return stop <= len(data) and data.startswith(self.head, at) and self.link.fits(data[at:stop])

    def with_head(self, data: bytes) -> bytes:
        """Return the whole reply where bytes are one but for its head; empty where they are not."""
        mended = self.head + data[len(self.head) :]
        return mended if len(data) == self.size and self.stands(mended, 0) else b""

    def begins(self, data: bytes) -> bool:
        """Say whether bytes can be its beginning."""
        size = min(len(data), len(self.head))
        return len(data) <= self.size and data[:size] == self.head[:size]


def reported(scene: Scene) -> list[tuple[Stretch, Stretch]]:
    """Return the requests that a library logs without their check, each with the code that it logs instead of a reply."""
    found: list[tuple[Stretch, Stretch]] = []
    sent: Stretch | None = None
    for burst in scene.bursts:
        if burst.direction is Role.REQUEST:
            sent = burst if burst.can_id is None and len(burst.data) >= _BARE and burst.data[1] in FUNCTIONS else None
        elif sent is not None and burst.direction is Role.REPLY and len(burst.data) == 1 and burst.data[0] in _CODES:
            # What came of a reply may stand before it.
            found.append((sent, burst))
            sent = None
    return found


class Placed(NamedTuple):
    """A sound reply among all that was received. `read`: the turn in which it begins; `shift`: bytes before it in this turn;
    `back`: how many requests were sent after its own and before it; `crosses`: it ends in a later turn.
    """

    read: Turn
    shift: int
    back: int
    crosses: bool


def awaited(message: Message) -> list[Awaited]:
    """Return the replies that a request can have."""
    command, dialect, data = message.command, message.frame.dialect, message.frame.data
    if command is None or dialect.bus == "can":
        return []
    if command in dialect.fallbacks.values():
        if data[1] in READS:
            quantity = int.from_bytes(data[4:6], "big")
            count = (quantity + 7) // 8 if data[1] < min(READS) + 2 else 2 * quantity
            return [Awaited(bytes((data[0], data[1], count & 0xFF)), 5 + count, dialect.link)]
        return [Awaited(data[:_WRITTEN] if data[1] in _WRITES else data[:4], 8, dialect.link)]
    found = []
    for form in command.reply_forms:
        wanted = form.request_values or {}
        if form.layout.open_ended or any(message.values.get(n) != v for n, v in wanted.items()):
            continue
        whole = dialect.link.build(command, form, message.address, bytes(form.layout.byte_length), Role.REPLY)
        found.append(Awaited(whole[: dialect.link.parse(whole).start], len(whole), dialect.link))
    return found


def replies_to(piece: Piece | None) -> list[Awaited]:
    """Return the replies that a piece can have, if it is a request."""
    return [] if piece is None or piece.message is None else awaited(piece.message)


@lru_cache(maxsize=1)
def chains(scene: Scene) -> tuple[tuple[Exchange, ...], ...]:
    """Return the exchanges of a serial bus, in rows without a gap."""
    rows: list[list[Exchange]] = []
    before: Turn | None = None
    for turn in _turns(scene):
        if before is None or before.stop != turn.offset:
            rows.append([])
        before = turn
        if turn.role is Role.REQUEST:
            rows[-1].append(Exchange(turn, []))
        elif rows[-1]:
            rows[-1][-1].received.append(turn)
    return tuple(tuple(row[:_MOST]) for row in rows if row)


def _turns(scene: Scene) -> Iterator[Turn]:
    """Yield what was sent at once: up to the limits of reads, and of sound frames where those do not tell."""
    run: list[Piece] = []
    for piece in scene.pieces:
        if piece.can is not None:
            return
        if run and run[-1].stop != piece.offset:
            yield from _cut(scene, run)
            run = []
        run.append(piece)
    if run:
        yield from _cut(scene, run)


def _cut(scene: Scene, run: list[Piece]) -> Iterator[Turn]:
    first, last = run[0].offset, run[-1].stop
    data = b"".join(piece.data for piece in run)
    limits = {n for n in scene.limits if first < n < last}
    for piece in run:
        if piece.message is not None and scene.direction(piece.offset) is not Role.REPLY:
            limits |= {piece.offset, piece.stop}
    whole = {(piece.offset, piece.stop): piece for piece in run}
    by_start = sorted(run, key=lambda p: p.offset)
    at, index = first, 0
    for stop in (*sorted(n for n in limits if first < n < last), last):
        while by_start[index].stop <= at:
            index += 1
        own = whole.get((at, stop))
        message = own.message if own is not None else None
        role = scene.direction(at)
        if role is Role.UNKNOWN and message is not None:
            role = message.role
        yield Turn(at, data[at - first : stop - first], by_start[index].t_ns, role, message, own)
        at = stop


@lru_cache(maxsize=1)
def fragments(scene: Scene) -> tuple[tuple[Exchange, Message], ...]:
    """Return the exchanges of a host that gets two or three bytes of each request back alone, each with what it asks.

    A drive in the other mode does that; it may drop the first byte, which it does not know. Empty where all can be replies.
    """
    found: list[tuple[Exchange, Message]] = []
    telling: set[bytes] = set()
    for exchange in (each for chain in chains(scene) for each in chain if each.received):
        sent, came = exchange.request.data, exchange.data
        size, asked = len(came), exchange.request.message or _bare(scene, sent)
        if asked is None or size not in _FRAGMENT or size + 1 >= len(sent) or came not in (sent[:size], sent[1 : size + 1]):
            return ()
        found.append((exchange, asked))
        if not any(reply.begins(came) for reply in awaited(asked)):
            telling.add(sent)
    return tuple(found) if telling and len({exchange.request.data for exchange, _ in found}) > 1 else ()


#: Bytes of a request that a drive in the other mode gives back.
_FRAGMENT = (2, 3)


def _bare(scene: Scene, data: bytes) -> Message | None:
    """Return the request that lacks its check."""
    readings = (scene.reader.best(d.link.completed(data), role=Role.REQUEST) for d in scene.reader.dialects)
    return next((reading.message for reading in readings if reading is not None), None)


@lru_cache(maxsize=1)
def placed(scene: Scene) -> tuple[Placed, ...]:
    """Return the sound replies among what was received, wherever they stand."""
    return tuple(found for chain in chains(scene) for found in _place(chain))


@lru_cache(maxsize=1)
def crossed(scene: Scene) -> frozenset[int]:
    """Return where the reads begin of which a sound reply ends in a later one."""
    return frozenset(each.read.offset for each in placed(scene) if each.crosses)


def _place(chain: tuple[Exchange, ...]) -> Iterator[Placed]:
    stream = b"".join(exchange.data for exchange in chain)
    reads = [(turn, number) for number, exchange in enumerate(chain) for turn in exchange.received]
    wanted = [awaited(e.request.message) if e.request.message is not None else [] for e in chain]
    heads = _Heads(stream)
    start = at = 0
    for turn, number in reads:
        stop = start + len(turn.data)
        near = [wanted[number - back] for back in range(min(number, _BACK) + 1)]
        known = {each.head for replies in near for each in replies}
        while (place := heads.first(known, at)) < stop:
            found = ((back, each.size) for back, replies in enumerate(near) for each in replies if each.stands(stream, place))
            back, size = next(found, (0, 0))
            if size:
                yield Placed(turn, place - start, back, place + size > stop)
            at = place + (size or 1)
        start = stop
        at = max(at, stop)


class _Heads:
    """Where replies can begin in a stream: junk is passed over from head to head, and each head is searched for once."""

    def __init__(self, stream: bytes) -> None:
        self._stream = stream
        #: Where each head stands next.
        self._next: dict[bytes, int] = {}

    def first(self, heads: Collection[bytes], at: int) -> int:
        """Return the first place from `at` on where one of them stands; the end of the stream if there is none."""
        return min((self._place(head, at) for head in heads), default=len(self._stream))

    def _place(self, head: bytes, at: int) -> int:
        place = self._next.get(head, -1)
        if place < at:
            place = self._stream.find(head, at)
            self._next[head] = place = len(self._stream) if place < 0 else place
        return place
