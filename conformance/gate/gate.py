"""The gate: the one place where bytes leave for a bus. It judges the bytes, whatever was meant by them.

    gate = Gate(line, Allowance(parse_allow("motion"), speed=300))
    gate.send(bytes.fromhex("FA 01 31 2C"))        judged, then written; Refused says what was found and why it may not leave

Every interpretation of the bytes (`gate.interpretations`: at any offset, in any dialect, whole or cut off, checks right or
wrong) has to be permitted (`gate.permissions`), within the bounds, and within the budget. Only then it is written, and only
here: nothing else may call `Line.write`.

Several gates on one line share what was sent: make the second one by `Gate.under`, never by `Gate(line, ...)`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy, deepcopy
from dataclasses import replace

from analyzer import dialects as registry
from analyzer.catalogue import Dialect, Risk, Role
from analyzer.errors import ServotapError
from analyzer.records import CanFrame, Chunk
from analyzer.reference.hex_frame import write_frame
from conformance.bus.line import Line
from conformance.gate.bounds import Knowledge, moves, runs, stops
from conformance.gate.budget import Budget, Cost
from conformance.gate.interpretations import CanInterpreter, Interpretation, Pending, SerialInterpreter
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


class _Sent:
    """What was sent on a line and can still matter; judges and gates of one line share it."""

    def __init__(self) -> None:
        self.pending = Pending()


class Judge:
    """Judges what is to leave, one item after the other; sends nothing.

    `dialects`: what may be spoken where it goes; by default every dialect there is. `wears` False: no real drive is there,
    whose flash could be worn.
    """

    def __init__(self, allowance: Allowance, dialects: Iterable[Dialect] | None = None, *, wears: bool = True) -> None:
        self.allowance = allowance
        self._wears = wears
        chosen = registry.every() if dialects is None else list(dialects)
        self._serial = SerialInterpreter([d for d in chosen if d.bus == "serial"])
        self._can = CanInterpreter([d for d in chosen if d.bus == "can"])
        self._sent = _Sent()
        self.known = Knowledge(allowance.subdivision)
        #: Bytes that do nothing but read, by what was pending: they were allowed, and nothing can change that.
        self._plain: dict[tuple[Pending, bytes], Pending] = {}

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
        return self._objections(self.interpret(item), now_ns, self.allowance.budget.refusal)

    def admit(self, item: Item, now_ns: int = 0) -> tuple[Interpretation, ...]:
        """Take it that an item leaves now, spend what it costs, and return its interpretations.

        Raises Refused, with nothing changed.
        """
        key = (self._sent.pending, item)
        after = self._plain.get(key) if isinstance(item, bytes) else None  # type: ignore[arg-type]
        if after is not None:
            self._sent.pending = after
            return ()
        found, after = self._interpret(item)
        objections = self._objections(found, now_ns, self.allowance.budget.take)
        if objections:
            raise Refused(item, objections)
        self._sent.pending = after
        for each in found:
            self.known.learn(each, now_ns)
        if isinstance(item, bytes) and all(each.reads_only for each in found):
            if len(self._plain) >= _KEPT:
                self._plain.clear()
            self._plain[key] = after  # type: ignore[index]
        return found

    # --- why not --------------------------------------------------------------------------------------------------

    def _objections(self, found: Sequence[Interpretation], now_ns: int, charge: Callable[[Cost, int], str]) -> list[Objection]:
        """Return what is not permitted; where all is, what `charge` says of the budget."""
        allowance, known = self.allowance, self.known
        objections = [o for each in found if (o := allowance.objection(each, known)) is not None]
        if objections:
            return objections
        beyond = charge(self._cost(found, now_ns), now_ns)
        return [Objection(next(each for each in found if _acts(each)), (beyond,))] if beyond else []

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
        self._judge.admit(item, self.line.now_ns())
        t_ns = self.line.write(item)
        self.sent += 1
        if self.log is not None:
            self.log(self._record(item, t_ns))
        for told in self.on_sent:
            told(t_ns, item)
        return t_ns

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
