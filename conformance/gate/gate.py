"""The gate: the one place where bytes leave for a bus. It judges the bytes, not the intention of the caller.

    gate = Gate(line, Allowance(parse_allow("motion"), speed=300))
    gate.send(bytes.fromhex("FA 01 31 2C"))        judged, then written; Refused says what was found and why it may not leave

`gate.interpretations` reads the bytes in every way: at any offset, in any dialect, whole or cut off, checks right or wrong.
Each interpretation has to be permitted (`gate.permissions`), within the bounds, and within the budget. Only then the bytes
are written, and only here: nothing else may call `Line.write`.

Several gates on one line share what was sent: make the second one by `Gate.under`, never by `Gate(line, ...)`.

A stop is never refused where motion is allowed. A lone, sound stop of an allowed drive passes after any bytes. If it would
complete a forbidden sound frame, reads of that drive (else bytes that begin no frame) go before it. Broken frames that could
not hold up a stop do not hold up the reads and stops behind it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from itertools import chain

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Risk, Role
from analyzer.encoder import build
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk
from analyzer.reference.hex_frame import write_frame
from conformance.bus.line import Line
from conformance.gate.bounds import Knowledge, moves, runs, stops
from conformance.gate.budget import Budget, Cost
from conformance.gate.interpretations import CanInterpreter, Interpretation, OpenHead, Pending, SerialInterpreter
from conformance.gate.permissions import Allowance, Objection, add_gate_arguments, allowance_from, parse_allow

__all__ = [
    "Allowance",
    "Budget",
    "Gate",
    "Interpretation",
    "Judge",
    "Objection",
    "Refused",
    "add_gate_arguments",
    "allowance_from",
    "parse_allow",
    "shown",
]

Item = bytes | CanFrame
#: What is told to those who listen to a gate: when the last of it was on the wire, and what it was.
Told = Callable[[int, Item], None]
#: Interpretations that a refusal lists.
_LISTED = 6
#: Items that are kept as allowed, for hosts that ask the same again and again.
_KEPT = 4096


class Refused(ServotapError):
    """Bytes that may not leave. `objections`: what can be read in them and is not allowed; `item`: the bytes."""

    def __init__(self, item: Item, objections: Sequence[Objection]) -> None:
        self.item = item
        self.objections = tuple(objections)
        lines = [str(o) for o in self.objections[:_LISTED]]
        more = len(self.objections) - _LISTED
        lines += [f"and {more} more"] * (more > 0)
        super().__init__(f"not sent: {shown(item)}\n  " + "\n  ".join(lines))


def shown(item: Item) -> str:
    """Return what is sent as hex; on CAN the identifier first."""
    if isinstance(item, CanFrame):
        return write_frame(item.data, item.id)
    text = write_frame(item[:64])
    return text + (f" ... ({len(item)} bytes)" if len(item) > 64 else "")


#: Reads that go before a stop at the most: more than the longest frame has room for.
_MOST_CLOSING = 32
#: How long the reply to such a read may take, beside its time on the wire.
_REPLY_NS = 20_000_000
_REPLY_BYTES = 20
_NOTHING = Pending()
#: Bytes that begin no frame of any dialect: the reads of a drive at FAh, FCh or 3Eh are heads themselves.
_FILLERS = (bytes(8), b"\x55" * 8, b"\x00\x55" * 4, b"\x55\x00" * 4)
#: What tells an item from every other, its time aside.
_Key = bytes | tuple[int, bytes, bool, bool, bool, bool]
#: A frame that a stop has passed in spite of: where it begins in all that was sent, and its slot.
_Passed = tuple[int, int]


def _key(item: Item) -> _Key:
    return (item.id, item.data, item.extended, item.remote, item.error, item.fd) if isinstance(item, CanFrame) else item


class _Sent:
    """What was sent on a line and can still matter; judges and gates of one line share it.

    `count`: bytes that have left; `passed`: what stops have passed in spite of.
    """

    def __init__(self) -> None:
        self.pending = _NOTHING
        self.count = 0
        self.passed: frozenset[_Passed] = frozenset()
        #: What came while a stop waited for its turn, for those who receive next.
        self.early: deque[Chunk | CanFrame] = deque()

    def place(self, each: Interpretation) -> _Passed:
        """Return what tells a frame from all others, before it has left."""
        return self.count + each.offset, each.slot


class Judge:
    """Judges items before they leave, one after the other; sends nothing.

    `dialects`: what may be spoken where it goes; by default every dialect there is. `wears` False: no real drive is there,
    whose flash could be worn.
    """

    def __init__(self, allowance: Allowance, dialects: Iterable[Dialect] | None = None, *, wears: bool = True) -> None:
        self.allowance = allowance
        self._wears = wears
        chosen = registry.every() if dialects is None else list(dialects)
        self._spoken = [d for d in chosen if d.bus == "serial"]
        self._serial = SerialInterpreter(self._spoken)
        self._can = CanInterpreter([d for d in chosen if d.bus == "can"])
        self._sent = _Sent()
        self.known = Knowledge(allowance.subdivision)
        #: What does nothing but read, by what was pending: it was allowed, and nothing can change that.
        self._plain: dict[tuple[Pending, _Key], Pending] = {}

    @property
    def early(self) -> deque[Chunk | CanFrame]:
        """What came while a stop waited for its turn, the first first."""
        return self._sent.early

    def under(self, allowance: Allowance) -> Judge:
        """Return a judge by another allowance, which shares with this one what was sent and what is known."""
        other = copy(self)
        other.allowance = allowance
        other._plain = {}
        return other

    def rehearsal(self) -> Judge:
        """Return a judge that knows what this one knows and shares nothing with it, to try out a series of sendings."""
        allowance = self.allowance
        other = self.under(replace(allowance, budget=allowance.budget.rehearsal()))
        other._sent, other.known = copy(self._sent), deepcopy(self.known)
        return other

    def interpret(self, item: Item) -> tuple[Interpretation, ...]:
        """Return the interpretations of an item, if it left now."""
        return self._interpret(item)[0]

    def _interpret(self, item: Item) -> tuple[tuple[Interpretation, ...], Pending]:
        pending = self._sent.pending
        return (self._can.interpret(item), pending) if isinstance(item, CanFrame) else self._serial.interpret(pending, item)

    def objections(self, item: Item, now_ns: int = 0) -> list[Objection]:
        """Return why an item may not leave now; empty where it may. Nothing changes by it."""
        return self._objections(item, self.interpret(item), now_ns, self.allowance.budget.refusal)

    def admit(self, item: Item, now_ns: int = 0, *, closing: bool = False) -> tuple[Interpretation, ...]:
        """Take it that an item leaves now, spend what it costs, and return its interpretations.

        `closing`: it goes before a stop, which would make sound what this leaves damaged. Raises Refused, with nothing changed.
        """
        key = (self._sent.pending, _key(item))
        after = self._plain.get(key)
        if after is not None:
            self._sent.pending = after
            self._sent.count += len(item) if isinstance(item, bytes) else 0
            return ()
        found, after = self._interpret(item)
        objections = self._objections(item, found, now_ns, self.allowance.budget.take)
        if closing:
            objections = _sound(objections)
        if objections:
            raise Refused(item, objections)
        sent = self._sent
        if isinstance(item, bytes):
            if closing or self.is_stop(item):
                sent.passed |= {sent.place(o.interpretation) for o in self._not_permitted(found)}
            sent.count += len(item)
        sent.pending = after
        for each in found:
            self.known.learn(each, now_ns)
        if all(each.reads_only for each in found):
            if len(self._plain) >= _KEPT:
                self._plain.clear()
            self._plain[key] = after
        return found

    # --- why not --------------------------------------------------------------------------------------------------

    def _objections(
        self, item: Item, found: Sequence[Interpretation], now_ns: int, charge: Callable[[Cost, int], str]
    ) -> list[Objection]:
        """Return what is not permitted; where all is, what `charge` says of the budget."""
        if self.is_stop(item):
            # The run that it ends is counted; what stands in the way of a stop is for `closing`.
            charge(self._cost([each for each in found if stops(each)], now_ns), now_ns)
            return []
        objections = self._not_permitted(found)
        if objections and self._sent.passed and self._reads(item):
            passed, place = self._sent.passed, self._sent.place
            objections = [o for o in objections if o.interpretation.fits or place(o.interpretation) not in passed]
        if objections:
            return objections
        beyond = charge(self._cost(found, now_ns), now_ns)
        return [Objection(next(each for each in found if _acts(each)), (beyond,))] if beyond else []

    def _not_permitted(self, found: Sequence[Interpretation]) -> list[Objection]:
        allowance, known = self.allowance, self.known
        return [o for each in found if (o := allowance.objection(each, known)) is not None]

    # --- stops ----------------------------------------------------------------------------------------------------

    def _alone(self, item: Item) -> tuple[Interpretation, ...]:
        """Return the interpretations of an item before which nothing was sent."""
        return self._can.interpret(item) if isinstance(item, CanFrame) else self._serial.interpret(_NOTHING, item)[0]

    def _reads(self, item: Item) -> bool:
        """Say whether an item is one that may leave where nothing was sent before, and only reads."""
        found = self._alone(item)
        return all(each.reads_only for each in found) and not self._not_permitted(found)

    def is_stop(self, item: Item) -> bool:
        """Say whether an item is a lone, sound stop of a drive that is meant, and no other sound frame."""
        return self._stop(item) is not None

    def _stop(self, item: Item) -> Interpretation | None:
        length = len(item.data if isinstance(item, CanFrame) else item)
        sound = [each for each in self._alone(item) if each.fits]
        whole = next((each for each in sound if each.offset == 0 and len(each.data) == length and self._is_stop(each)), None)
        return whole if whole is not None and all(each.reads_only or self._is_stop(each) for each in sound) else None

    def _is_stop(self, each: Interpretation) -> bool:
        meant = self.allowance.addresses is None or each.address in self.allowance.addresses or self.allowance.alone
        return stops(each) and meant and not each.to_many and each.risks <= self.allowance.risks

    def _completes(self, item: bytes) -> bool:
        """Say whether an item is the last piece of a sound frame that may not leave."""
        own = {(0, len(item))}
        found = (o.interpretation for o in self._not_permitted(self.interpret(item)))
        return any(each.fits and (each.offset, each.offset + len(each.data)) not in own for each in found)

    # --- what is left open ----------------------------------------------------------------------------------------

    def left_open(self, item: Item) -> tuple[OpenHead, ...]:
        """Return the frames that an item would leave begun, and that the next sending could make more than reads."""
        return () if isinstance(item, CanFrame) else self._serial.open_heads(self._interpret(item)[1])

    def ending(self, drive: tuple[Dialect, int] | None) -> Iterator[bytes]:
        """Yield what ends frames that were sent and are open: reads of a drive, or bytes that begin no frame.

        Each has to be sent before the next is asked for. What still is open then could be ended by no allowed bytes.
        """
        reads = [] if drive is None else [r for r in _plain_reads(*drive) if not self._serial.ends_open(r)]
        for _ in range(_MOST_CLOSING):
            if not self._serial.open_heads(self._sent.pending):
                return
            allowed = [r for r in (*reads, *_FILLERS) if not self.objections(r)]
            if not allowed:
                return
            yield min(allowed, key=lambda r: len(self.left_open(r)))

    def closing(self, item: Item) -> Iterator[bytes]:
        """Yield what has to leave before a stop, so that no sound frame ends with it that may not leave: reads, or fillers.

        Each has to be sent before the next is asked for.
        """
        stop = None if isinstance(item, CanFrame) else self._stop(item)
        if stop is None or isinstance(item, CanFrame) or stop.address is None:
            return
        # One of another length helps where sums are such that each of these would end the frame as well.
        own = [r for d in sorted(self._spoken, key=lambda d: d is not stop.dialect) for r in _plain_reads(d, stop.address)]
        for _ in range(_MOST_CLOSING):
            if not self._completes(item):
                return
            reads = (r for r in own if not self.objections(r))
            fillers = (f for f in _FILLERS if not _sound(self.objections(f)))
            before = next(chain(reads, fillers), None)
            if before is None:
                return
            yield before

    def _cost(self, found: Sequence[Interpretation], now_ns: int) -> Cost:
        """Return what an item costs: nothing if it only reads; a stop the turns of the run that it ends."""
        turns: float | None = 0.0
        for each in found:
            if turns is not None and self.allowance.budget.turns is not None:
                one = self._turns(each, now_ns)
                turns = None if one is None else turns + one
        acting = [each for each in found if _acts(each)]
        return Cost(1 if acting else 0, turns, self._wears and any(Risk.WEAR in each.risks for each in acting))

    def _turns(self, asked: Interpretation, now_ns: int) -> float | None:
        known = self.known
        if asked.command is None or asked.reads_only:
            return 0.0
        ends = stops(asked)
        before = known.run_turns(asked, now_ns) if ends or moves(asked) else 0.0
        if ends or (runs(asked) and known.rpm(asked) is not None):
            # How far a run turns is known when the next command ends it.
            return before
        own = known.turns(asked)
        return None if own is None else own + before


def _plain_reads(dialect: Dialect, address: int) -> Sequence[bytes]:
    """Return the requests of a drive on a serial line that only read, without values; none where it has no such address."""
    if not dialect.addresses[0] <= address <= dialect.addresses[1]:
        return ()
    kept: dict[int, list[bytes]] = dialect.__dict__.setdefault("_plain_reads", {})
    if address not in kept:
        commands = [c for c in dialect.commands if c.all_risks == {Risk.READ} and c.reply_forms and c.request_forms]
        plain = [c for c in commands if not c.request_forms[0].layout.named and not c.models]
        kept[address] = [build(dialect, c, address) for c in plain]
    return kept[address]


def _sound(objections: Iterable[Objection]) -> list[Objection]:
    return [o for o in objections if o.interpretation.fits]


def _acts(asked: Interpretation) -> bool:
    """Say whether a request does something, stops aside: those are never refused by a budget."""
    return not asked.reads_only and not stops(asked)


class Gate:
    """Sends on a line what is allowed.

    `log` gets what leaves and what comes, as records with their times. `sent`: items that have left; `on_sent`: called for
    each, with the time at which the last of it was on the wire.
    """

    def __init__(
        self,
        line: Line,
        allowance: Allowance,
        *,
        dialects: Iterable[Dialect] | None = None,
        log: Callable[[Chunk | CanFrame], None] | None = None,
    ) -> None:
        self.line = line
        self._judge = Judge(allowance, dialects, wears=not line.emulated)
        self.log = log
        self.sent = 0
        self.on_sent: list[Told] = []

    @property
    def allowance(self) -> Allowance:
        """What may be sent."""
        return self._judge.allowance

    def under(self, allowance: Allowance) -> Gate:
        """Return a gate to the same line by another allowance; both know what the other sent."""
        other = copy(self)
        other._judge = self._judge.under(allowance)
        return other

    # --- sending --------------------------------------------------------------------------------------------------

    def send(self, item: Item) -> int:
        """Judge and write an item; return the time at which the last of it is on the wire.

        Raises Refused, with nothing sent; LineLost.
        """
        self._close_by(self._judge.closing(item))
        return self._put(item)

    def _put(self, item: Item, *, closing: bool = False) -> int:
        self._judge.admit(item, self.line.now_ns(), closing=closing)
        t_ns = self.line.write(item)
        self.sent += 1
        if self.log is not None:
            self.log(self._record(item, t_ns))
        for told in self.on_sent:
            told(t_ns, item)
        return t_ns

    def _close_by(self, items: Iterable[bytes]) -> None:
        for item in items:
            try:
                self._put(item, closing=True)
            except Refused:
                # By the guard behind this line, which closes by itself what it has to: the stop must not wait for that.
                continue
            if item in _FILLERS:
                continue
            # A stop that the drive's reply runs into is not heard.
            wire_ns = (len(item) + _REPLY_BYTES) * self.line.byte_ns
            self._judge.early.extend(self.wait(wire_ns + _REPLY_NS))

    def end_stream(self, drive: tuple[Dialect, int] | None = None) -> None:
        """End what was sent and is open: the next program must not complete it. By reads of a drive, where one is named."""
        if not self.line.is_can:
            self._close_by(self._judge.ending(drive))

    def interpret(self, item: Item) -> tuple[Interpretation, ...]:
        """Return the interpretations of an item, if it left now; nothing is sent."""
        return self._judge.interpret(item)

    def objections(self, item: Item) -> list[Objection]:
        """Return why an item may not leave now; empty where it may."""
        return self._judge.objections(item, self.line.now_ns())

    def rehearsal(self) -> Judge:
        """Return a judge that starts from what this gate knows, to try out a series of sendings; nothing is sent."""
        return self._judge.rehearsal()

    def note_subdivision(self, value: int, address: int | None = None) -> None:
        """Take it that a drive (None: every drive) is set to a subdivision, for its real speed and its pulses."""
        self._judge.known.note_subdivision(value, address)

    def note_position(self, degrees: float, address: int, pulses: int | None = None) -> None:
        """Take it that a drive's shaft stands at `degrees` over all turns, and at a count of pulses where known."""
        self._judge.known.note_position(degrees, address, pulses)

    def _record(self, item: Item, t_ns: int) -> Chunk | CanFrame:
        name = self.line.endpoint.name
        if isinstance(item, CanFrame):
            return CanFrame(t_ns, name, item.id, item.data, Role.REQUEST, item.extended, item.remote, item.error, item.fd)
        return Chunk(t_ns, name, item, Role.REQUEST, True)

    # --- the rest of the line -------------------------------------------------------------------------------------

    def now_ns(self) -> int:
        return self.line.now_ns()

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        if self._judge.early:
            return self._judge.early.popleft()
        got = self.line.receive(timeout_ns)
        if got is not None and self.log is not None:
            self.log(got)
        return got

    def wait(self, duration_ns: int) -> list[Chunk | CanFrame]:
        got = self.line.wait(duration_ns)
        if self.log is not None:
            for item in got:
                self.log(item)
        return got

    def set_speed(self, bits_per_second: int) -> None:
        self.line.set_speed(bits_per_second)

    def close(self) -> None:
        self.line.close()
