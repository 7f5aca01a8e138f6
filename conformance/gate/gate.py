"""The gate: the one place where bytes leave for a bus. It judges them, not what somebody meant by them.

    gate = Gate(line, Allowance(parse_allow("motion"), speed=300))
    gate.send(bytes.fromhex("FA 01 31 2C"))        judged, then written; Refused says what could be read and why not

Every frame that can be read in what leaves (`gate.interpretations`: at any offset, in any dialect, whole or cut off,
its checks right or wrong) is held against what is allowed (`gate.permissions`), and within its bounds and budget.
Only then is it written, and only here: nothing else may call `Line.write`.

Several gates on one line share what was sent: take the second one by `Gate.under`, never by `Gate(line, ...)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy, deepcopy
from dataclasses import replace

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Risk, Role, Verb
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk
from analyzer.reference.hex_frame import write_frame
from conformance.bus.line import Line
from conformance.gate.bounds import STOPS, Knowledge, moves
from conformance.gate.budget import Budget, Cost
from conformance.gate.interpretations import CanReader, Reading, SerialReader, Stream
from conformance.gate.permissions import Allowance, Objection, add_gate_arguments, allowance_from, parse_allow

__all__ = [
    "Allowance",
    "Budget",
    "Gate",
    "Judge",
    "Objection",
    "Reading",
    "Refused",
    "add_gate_arguments",
    "allowance_from",
    "parse_allow",
    "shown",
]

Item = bytes | CanFrame
#: What is told to those who listen to a gate: when the last of it was on the wire, and what it was.
Told = Callable[[int, Item], None]
#: Readings that a refusal lists.
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


class _Sent:
    """What was sent on a line, as far as it can still matter; judges and gates of one line share it."""

    def __init__(self) -> None:
        self.stream = Stream()


class Judge:
    """Judges what is to leave, one item after the other; sends nothing.

    `dialects`: what may be spoken where it goes; by default every dialect there is. `wears` False: no real drive is there,
    whose flash could be worn.
    """

    def __init__(self, allowance: Allowance, dialects: Iterable[Dialect] | None = None, *, wears: bool = True) -> None:
        self.allowance = allowance
        self._wears = wears
        chosen = registry.every() if dialects is None else list(dialects)
        self._serial = SerialReader([d for d in chosen if d.bus == "serial"])
        self._can = CanReader([d for d in chosen if d.bus == "can"])
        self._sent = _Sent()
        self.known = Knowledge(allowance.subdivision)
        #: Bytes that do nothing but read, by the stream they follow: they were allowed, and nothing can change that.
        self._plain: dict[tuple[Stream, bytes], Stream] = {}

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

    def read(self, item: Item) -> tuple[Reading, ...]:
        """Return what can be read in an item, if it left now."""
        return self._read(item)[0]

    def _read(self, item: Item) -> tuple[tuple[Reading, ...], Stream]:
        if isinstance(item, CanFrame):
            return self._can.read(item), self._sent.stream
        return self._serial.read(self._sent.stream, item)

    def objections(self, item: Item, now_ns: int = 0) -> list[Objection]:
        """Return why an item may not leave now; empty where it may. Nothing changes by it."""
        readings = self.read(item)
        found = self._objections(readings)
        return found or self._beyond(self.allowance.budget.refusal(self._cost(readings, now_ns), now_ns), readings)

    def admit(self, item: Item, now_ns: int = 0) -> tuple[Reading, ...]:
        """Take it that an item leaves now, spend what it costs, and return what can be read in it.

        Raises Refused, with nothing changed.
        """
        key = (self._sent.stream, item)
        after = self._plain.get(key) if isinstance(item, bytes) else None  # type: ignore[arg-type]
        if after is not None:
            self._sent.stream = after
            return ()
        readings, after = self._read(item)
        found = self._objections(readings)
        if not found:
            found = self._beyond(self.allowance.budget.take(self._cost(readings, now_ns), now_ns), readings)
        if found:
            raise Refused(item, found)
        self._sent.stream = after
        for reading in readings:
            self.known.learn(reading, now_ns)
        if isinstance(item, bytes) and all(r.reads_only for r in readings):
            if len(self._plain) >= _KEPT:
                self._plain.clear()
            self._plain[key] = after  # type: ignore[index]
        return readings

    # --- why not --------------------------------------------------------------------------------------------------

    def _objections(self, readings: Sequence[Reading]) -> list[Objection]:
        allowance, known = self.allowance, self.known
        return [o for reading in readings if (o := allowance.objection(reading, known)) is not None]

    @staticmethod
    def _beyond(reason: str, readings: Sequence[Reading]) -> list[Objection]:
        return [Objection(next(r for r in readings if _acts(r)), (reason,))] if reason else []

    def _cost(self, readings: Sequence[Reading], now_ns: int) -> Cost:
        """Return what an item costs: nothing if it only reads; a stop the turns of the run that it ends."""
        turns: float | None = 0.0
        for reading in readings:
            if turns is not None and self.allowance.budget.turns is not None:
                one = self._turns(reading, now_ns)
                turns = None if one is None else turns + one
        acting = [r for r in readings if _acts(r)]
        return Cost(1 if acting else 0, turns, self._wears and any(Risk.WEAR in r.risks for r in acting))

    def _turns(self, reading: Reading, now_ns: int) -> float | None:
        known, command = self.known, reading.command
        if command is None or reading.reads_only:
            return 0.0
        stops = command.verb in STOPS
        before = known.run_turns(reading, now_ns) if stops or moves(reading) else 0.0
        if stops or (command.verb is Verb.RUN_SPEED and known.rpm(reading) is not None):
            # How far a run turns is known when the next command ends it.
            return before
        own = known.turns(reading)
        return None if own is None else own + before


def _acts(reading: Reading) -> bool:
    """Say whether a reading does something, stops aside: those are never refused by a budget."""
    return not reading.reads_only and (reading.command is None or reading.command.verb not in STOPS)


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
        self._judge.admit(item, self.line.now_ns())
        t_ns = self.line.write(item)
        self.sent += 1
        if self.log is not None:
            self.log(self._record(item, t_ns))
        for told in self.on_sent:
            told(t_ns, item)
        return t_ns

    def judge(self, item: Item) -> tuple[Reading, ...]:
        """Return what can be read in an item, if it left now; nothing is sent."""
        return self._judge.read(item)

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
        """Return the time of the line's clock."""
        return self.line.now_ns()

    def receive(self, timeout_ns: int) -> Chunk | CanFrame | None:
        """Return what comes next, None when the time is over. Raises LineLost."""
        got = self.line.receive(timeout_ns)
        if got is not None and self.log is not None:
            self.log(got)
        return got

    def wait(self, duration_ns: int) -> list[Chunk | CanFrame]:
        """Let time pass and return what came meanwhile. Raises LineLost."""
        got = self.line.wait(duration_ns)
        if self.log is not None:
            for item in got:
                self.log(item)
        return got

    def set_speed(self, bits_per_second: int) -> None:
        """Change this end's speed. Raises UsageError where it cannot be changed."""
        self.line.set_speed(bits_per_second)

    def close(self) -> None:
        """Give the port back."""
        self.line.close()
