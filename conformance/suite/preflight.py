"""Checks before the first claim: the drive answers, it is the named one, and it is alone if the user says so.

Reads alone find a drive that is missing, has another speed or address, or speaks another dialect. One message reports it.
A drive that answers wrongly is let through: the claims say what is wrong with it. One whose replies all come one question late
is not, for no claim could tell what answers what.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect
from analyzer.diagnosis.diagnose import lines
from analyzer.encoder import assemble
from analyzer.errors import UsageError
from analyzer.records import CanFrame, Chunk
from analyzer.values import printable
from conformance.claim import RigFault
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance
from conformance.safety.stopping import flood
from conformance.talk.dialogue import MS, Dialogue
from conformance.talk.scan import LISTEN_NS, PATIENCE_NS, Finder, Found, Report, scan, search_read, search_reads

#: Addresses at which a drive that is not there is looked for.
_NEAR = range(1, 33)
#: How long the first byte of another drive's answer may take while all addresses are looked at: drives take half a
#: millisecond. One that is later still, or whose adapter is, is heard while the next ones are asked, or at the end.
_PROMPT_NS = 3 * MS
#: A late answer may collide with the next question: bytes that are no answer may be of one of so many that were asked last.
_SUSPECTS = PATIENCE_NS // _PROMPT_NS
_LATE_NS = 300 * MS
#: Bits of the longest frame of 11 bits, stuffed.
_CAN_BITS = 135
#: A drive that moves was seen to take 0.7 s for an answer.
_PATIENT_NS = 1000 * MS
_ATTEMPTS = 3
#: How long an answer may take where it is looked at what it answers.
_BEHIND_NS = 300 * MS
_SECOND_NS = 1_000_000_000
#: Places that a message lists.
_LISTED = 8


class DriveNotFound(RigFault):
    """The drive that was named does not answer, or another one does."""


@dataclass(frozen=True)
class Search:
    """What came of looking for one drive. `elsewhere`: drives that answered in its place; `text`: the result in words."""

    found: Found | None
    elsewhere: tuple[Found, ...]
    text: str
    report: Report


def check(gate: Gate, dialect: Dialect, address: int, *, alone: bool, spoken: frozenset[str] | None = None) -> str:
    """Make sure that the drive answers, and with `alone` that no other does; return its firmware as far as it reports it.

    `spoken`: the dialects in which others are looked for, None: all of the bus. Sends reads only.

    Raises DriveNotFound with what came instead, or where others fill the line.
    """
    if full := _full(gate, dialect):
        raise DriveNotFound(f"{registry.drive_name(dialect, address)} cannot be asked on {gate.line.endpoint.text}: {full}")
    search = find_drive(gate, dialect, address)
    if search.found is None and (search.elsewhere or not any(s.data for s in search.report.strays)):
        raise DriveNotFound(search.text)
    if _is_behind(gate, dialect, address):
        raise RigFault(
            f"{registry.drive_name(dialect, address)} answers each question with its reply to the one before: nothing can "
            "be judged. Start it anew, and what stands between (adapter, gateway, converter); one of them holds a reply back"
        )
    if alone:
        same_bus = [d for d in registry.every() if d.bus == dialect.bus]
        looked_for = [d for d in same_bus if spoken is None or d.name in spoken or d.name == dialect.name]
        near = neighbours(gate, looked_for, own=(address,))
        if near.names:
            raise DriveNotFound(f"--alone was given, but {', '.join(near.names)} answers too: nothing was sent but reads")
        if near.unasked:
            raise DriveNotFound(
                f"--alone was given, but {_listed(near.unasked)} cannot be looked for: the question would do something to a "
                "drive of another dialect (--spoken names those of this bus); nothing was sent but reads"
            )
    return search.found.identity if search.found is not None else ""


def _is_behind(gate: Gate, dialect: Dialect, address: int) -> bool:
    """Say whether the replies to two reads, which differ in length, all come one question late. Raises LineLost."""
    own = gate.under(Allowance())
    reads = [c for c in search_reads(dialect) if not own.objections(assemble(dialect, c, address).item())]
    lengths = [{form.layout.byte_length for form in c.reply_forms} for c in reads]
    other = next((c for c, found in zip(reads, lengths, strict=True) if not found & lengths[0]), None)
    if other is None:
        return False
    dialogue = Dialogue(own, [dialect])

    def length(command: Command) -> int:
        return len(dialogue.ask(assemble(dialect, command, address).item(), _BEHIND_NS).received)

    length(reads[0])
    first = length(reads[0])
    # A drive that is not behind answers otherwise here, and is asked no more.
    if not first or length(other) != first:
        return False
    late = length(other)
    return late not in (0, first) and length(reads[0]) == late and length(other) == first


def _full(gate: Gate, dialect: Dialect) -> str:
    """Listen, and say how much others send on a serial line, if that is half of what it brings; else nothing."""
    if gate.line.is_can:
        return ""
    heard = Dialogue(gate.under(Allowance()), [dialect]).listen(LISTEN_NS)
    count, duration_ns = len(heard.received) + heard.passed, heard.until_ns - heard.sent_ns
    if count * _SECOND_NS < gate.line.brings * duration_ns // 2:
        return ""
    return "; ".join(flood(count, duration_ns, gate.line))


def _listed(names: Sequence[str]) -> str:
    more = len(names) - _LISTED
    return ", ".join(names[:_LISTED]) + (f" and {more} more" if more > 0 else "")


@dataclass(frozen=True)
class Neighbours:
    """The other drives of a line by name. `unasked`: places that were not looked at."""

    names: tuple[str, ...] = ()
    unasked: tuple[str, ...] = ()


def neighbours(gate: Gate, dialects: Sequence[Dialect], own: Iterable[int]) -> Neighbours:
    """Look for drives at every address that their dialect has, those at `own` aside. Raises LineLost."""
    mine = frozenset(own)
    everywhere = {d.name: [a for a in range(d.addresses[0], d.addresses[1] + 1) if a not in mine] for d in dialects}
    if not gate.line.is_can:
        report = scan(gate, dialects, addresses=everywhere, busy=True, patience_ns=_PROMPT_NS, late_ns=_LATE_NS)
        suspects = _suspects(report, dialects, everywhere)
        if suspects:
            scan(gate, dialects, addresses=suspects, busy=True, report=report)
        names = dict.fromkeys(f.name for f in report.found if f.address not in mine)
        return Neighbours(tuple(names), tuple(dict.fromkeys(report.refused)))
    found = [_on_can(gate.under(Allowance()), d, everywhere[d.name]) for d in dialects]
    return Neighbours(tuple(n for each in found for n in each.names), tuple(n for each in found for n in each.unasked))


def _suspects(report: Report, dialects: Sequence[Dialect], asked: Mapping[str, Sequence[int]]) -> dict[str, list[int]]:
    """Return the addresses, by dialect, that were asked when bytes came that are no answer, and shortly before."""
    order = [(d, address) for d in dialects for address in asked[d.name]]
    strays = {stray.asked for stray in report.strays}
    hit = [place for place, drive in enumerate(order) if registry.drive_name(*drive) in strays]
    suspects = sorted({before for place in hit for before in range(max(0, place - _SUSPECTS), place + 1)})
    found: dict[str, list[int]] = {d.name: [] for d in dialects} if hit else {}
    for dialect, address in (order[place] for place in suspects):
        found[dialect.name].append(address)
    return found


def _on_can(gate: Gate, dialect: Dialect, addresses: Sequence[int]) -> Neighbours:
    """Ask all of them without waiting for one: on CAN the identifier says whose reply it is."""
    frame_ns = _CAN_BITS * 1_000_000_000 // gate.line.endpoint.bits_per_second
    heard: list[Chunk | CanFrame] = []
    unasked: list[str] = []
    asked: dict[int | None, tuple[int, int]] = {}
    for address in addresses:
        command = search_read(dialect, address, gate)
        built = assemble(dialect, command, address)
        # A question that a drive of another dialect could take for a command is not asked.
        if gate.objections(built.item()):
            unasked.append(registry.drive_name(dialect, address))
            continue
        asked[built.can_id] = address, command.code
        gate.send(built.item())
        # Interfaces have room for a few frames only.
        heard += gate.wait(2 * frame_ns)
    heard += gate.wait(_LATE_NS)
    frames = [f for f in heard if isinstance(f, CanFrame) and f.id in asked]
    found = {asked[f.id][0] for f in frames if dialect.link.parse(f.data, f.id).code == asked[f.id][1]}
    return Neighbours(tuple(registry.drive_name(dialect, address) for address in sorted(found)), tuple(unasked))


def find_drive(gate: Gate, dialect: Dialect, address: int, *, widely: bool = True) -> Search:
    """Look for one drive on the line of a gate. `widely` False: say only whether it answers.

    The line is left at the rate it had. Raises LineLost.
    """
    report = Report(kind=dialect.bus)
    finder = Finder(gate, [dialect], _PATIENT_NS)
    for _ in range(_ATTEMPTS):
        found, exchange = finder.find(dialect, address)
        if found is not None and found.address == address:
            return Search(found, (), f"{found.name} answers at {found.speed} bit/s", report)
        report.keep(gate.line.endpoint.bits_per_second, exchange)
        if exchange.received:
            break
    elsewhere = _elsewhere(gate, dialect, address, report) if widely else []
    return Search(None, tuple(elsewhere), _text(gate, dialect, address, elsewhere, exchange.received, report), report)


def _elsewhere(gate: Gate, dialect: Dialect, address: int, report: Report) -> list[Found]:
    """Look where a drive may be that is not where it was said: the likeliest place first, until one answers."""
    own = gate.line.endpoint.bits_per_second
    others = [d for d in registry.every() if d.bus == dialect.bus and d.name != dialect.name]
    rates = [r for r in dialect.baud_rates if r != own]
    first = dialect.addresses[0]
    wide = sorted({address, first, *(a for a in _NEAR if a >= first)})
    places = [(others, (address,), (own,)), ([dialect], wide, (own,)), ([dialect, *others], (address,), rates)]
    for dialects, addresses, speeds in places:
        if not dialects or not speeds:
            continue
        try:
            scan(gate, dialects, addresses=addresses, rates=speeds, enough=lambda found: True, report=report, busy=True)
        except UsageError:
            # A line whose speed cannot be set from here has no other rates.
            continue
        if report.found:
            break
    return list(report.found)


def _text(gate: Gate, dialect: Dialect, address: int, elsewhere: Sequence[Found], received: bytes, report: Report) -> str:
    place = gate.line.endpoint
    asked = f"{registry.drive_name(dialect, address)} does not answer on {place.text} at {place.bits_per_second} bit/s"
    for found in elsewhere:
        if found.dialect.name != dialect.name:
            return f"{asked}, but {found.name} does at {found.speed} bit/s: it speaks another dialect"
        if found.speed != place.bits_per_second:
            return f"{asked}, but it does at {found.speed} bit/s: the line is at another rate than the drive"
        return f"{asked}, but {found.name} does: it has another address"
    noise = (
        f"; {len(received)} bytes came that are no answer ({received[:16].hex(' ').upper()})" if received else "; nothing came"
    )
    report.dialects = report.dialects or (dialect.name,)
    causes = [] if (diagnosis := report.diagnosis) is None else [printable(line) for line in lines(diagnosis)]
    return f"{asked}{noise}\n  " + "\n  ".join([*causes, *report.hints])
