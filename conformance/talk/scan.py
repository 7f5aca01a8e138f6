"""Finding drives: reads to addresses, dialects and rates, and what the answers, or the noises, say.

    report = scan(gate, dialects, addresses=range(1, 33), rates=(38400, 115200))
    report.found, report.hints

Only reads are sent, through a gate that allows nothing else. For each dialect it is the read that every drive of it answers
and that says most (a status, a state). A drive that answered is asked for its version and its state too.

Before the first byte the scan listens: on a bus that a machine uses, a question at the wrong moment spoils the traffic of
others. There nothing is sent unless the caller wants it (`busy`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Risk, Role, Verb
from analyzer.decoder import physical
from analyzer.diagnosis.diagnose import Diagnosis, of_traffic
from analyzer.dialects import drive_name
from analyzer.encoder import assemble
from analyzer.errors import UsageError
from analyzer.records import CanFrame, Chunk
from conformance.gate.gate import Gate, Refused
from conformance.gate.permissions import Allowance
from conformance.talk.dialogue import MS, Dialogue
from conformance.talk.exchange import Answer, Exchange

#: Reads by which drives are looked for, the best first: a drive answers each at any time, if it has it.
_SEARCH_READS = (Verb.READ_STATUS, Verb.READ_STATE_1, Verb.READ_VERSION, Verb.READ_SPEED, Verb.READ_POSITION)
#: Further reads to a drive that answered.
_MORE = (Verb.READ_VERSION, Verb.READ_STATE_1, Verb.READ_ENABLED, Verb.READ_SPEED)
#: How long the first byte of an answer may take: a drive's own time, and an adapter's latency timer.
PATIENCE_NS = 40 * MS
#: How long the scan listens before it sends.
LISTEN_NS = 250 * MS
_SECOND_NS = 1_000_000_000


class StrayKind(StrEnum):
    """What bytes look like that came and are no answer."""

    REPLY = "a reply from another address"
    OTHER_DIALECT = "a frame of another dialect"
    LOW = "a line that stays low"
    WRONG_RATE = "no frames: another rate, or noise"
    REQUEST = "requests of another host"


#: Records of a rate that are kept to be diagnosed.
_KEPT = 4000


@dataclass(frozen=True)
class Found:
    """A drive that answered. `values`: physical values that it sent; `wrong`: what is wrong with its answer, or nothing."""

    dialect: Dialect
    address: int
    speed: int
    latency_ns: int
    reply: bytes
    values: Mapping[str, Any] = field(default_factory=dict)
    wrong: str = ""

    @property
    def name(self) -> str:
        """DIALECT@ADDRESS."""
        return drive_name(self.dialect, self.address)

    @property
    def identity(self) -> str:
        """Firmware and type, as far as it reported any."""
        values = self.values
        parts = [str(values["hardware_name"])] if "hardware_name" in values else []
        if "firmware_major" in values:
            numbers = (f"firmware_{n}" for n in ("major", "minor", "patch"))
            parts.append(f"firmware {'.'.join(str(values[n]) for n in numbers if n in values)}")
        if "voltage" in values:
            parts.append(f"{values['voltage']:g} V")
        return ", ".join(parts)


@dataclass(frozen=True)
class Stray:
    """Bytes that came and are no answer. `asked`: the drive that was asked then; empty: none was."""

    speed: int
    asked: str
    data: bytes
    kind: StrayKind


@dataclass
class Report:
    """What a scan found. `rates`: those that it tried; `stopped`: why it did not look everywhere, or nothing.

    `interrupted`: a signal is why.

    `refused`: drives that were not asked, for the question is more than a read in another dialect of the bus.
    """

    found: list[Found] = field(default_factory=list)
    strays: list[Stray] = field(default_factory=list)
    asked: int = 0
    refused: list[str] = field(default_factory=list)
    rates: list[int] = field(default_factory=list)
    dialects: tuple[str, ...] = ()
    echoes: bool = False
    stopped: str = ""
    interrupted: bool = False
    kind: str = "serial"
    #: Frames of nodes that are no drives, by identifier.
    others: Counter[str] = field(default_factory=Counter)
    #: What went over the line, by rate, with an end.
    traffic: dict[int, list[Chunk | CanFrame]] = field(default_factory=dict)

    def keep(self, rate: int, exchange: Exchange) -> None:
        """Keep what went over the line."""
        kept = self.traffic.setdefault(rate, [])
        if len(kept) < _KEPT:
            kept += exchange.records()

    @property
    def diagnosis(self) -> Diagnosis | None:
        """What is wrong on the bus, as far as the bytes tell that came at the rate with most of them; None where none came."""
        came = {rate: sum(i.direction is not Role.REQUEST for i in items) for rate, items in self.traffic.items()}
        rate = max(came, key=came.__getitem__, default=None)
        if self.found or rate is None or not came[rate]:
            return None
        found = of_traffic(self.traffic[rate], [registry.get(name) for name in self.dialects])
        return found if found.causes else None

    @property
    def hints(self) -> list[str]:
        """What to check, the likeliest first; empty where drives answered and nothing is odd."""
        if self.interrupted:
            return []
        if self.stopped:
            return ["end the other host, or read its traffic: servotap record ENDPOINT; --busy asks all the same"]
        result: list[str] = []
        kinds = Counter(stray.kind for stray in self.strays)
        if self.echoes:
            result.append("the adapter hands back what it sends (its receiver stays on): that was left out")
        if self.refused:
            unasked = ", ".join(dict.fromkeys(self.refused))
            result.append(f"not asked, for the question would do something to a drive of another dialect: {unasked}")
        crowded = Counter((f.dialect.bus, f.address, f.speed) for f in self.found)
        for (_, address, _), count in crowded.items():
            names = sorted({f.dialect.name for f in self.found if f.address == address})
            if count > 1:
                result.append(f"address {address} answers in {' and '.join(names)}: two drives have one address")
        odd = [f for f in self.found if f.wrong]
        result += [f"{f.name}: {f.wrong}: two drives of one address, or a poor line (termination, ground)" for f in odd]
        if kinds[StrayKind.LOW] and not self.found:
            result.append("the line stays low: A and B are swapped, or there is no bias (termination, pull-up)")
        if kinds[StrayKind.WRONG_RATE] and not self.found:
            result.append("bytes came that are no frames: a drive at another rate, two drives of one address, or a poor line")
        if kinds[StrayKind.OTHER_DIALECT]:
            result.append("frames of another dialect came: name it with --dialects, or leave that out")
        if kinds[StrayKind.REQUEST]:
            result.append("another host sends on this bus: the answers may have been to it")
        if not self.found:
            result += _CAN_SILENCE if self.kind == "can" else _SERIAL_SILENCE
        return result


_SERIAL_SILENCE = (
    "wiring: is the drive powered, A to A and B to B, and a common ground? Makers name A and B differently: swap them once",
    "address and rate: the drive's menu shows them (MKS: UartAddr, UartBaud); --addresses and --rates widen the search",
    "mode: an MKS drive answers native frames or Modbus, as its Mb_RTU says, never both; both were asked"
    " unless --dialects said otherwise",
    "adapter: has it RS485, not RS232 or TTL, and does it switch its direction by itself?",
    "another program on the same port, or a second host on the bus, takes the answers away",
)
_CAN_SILENCE = (
    "wiring: is the drive powered, H to H and L to L, and a common ground?",
    "termination: 120 ohm at both ends of the bus (60 ohm between H and L with the power off)",
    "bit rate and ID: the drive's menu shows them (CanRate, CanID); a bus at the wrong rate is silent",
    "bus state: ip -details link show can0 says ERROR-PASSIVE or BUS-OFF where no node acknowledges",
)

#: Called as a scan goes on: questions asked, questions there are, and where it is.
Progress = Callable[[int, int, str], None]


def search_reads(dialect: Dialect) -> list[Command]:
    """Return the reads by which a drive of a dialect can be looked for, the best first: without values, changing nothing."""
    plain = [c for c in dialect.commands if _is_plain_read(c)]
    if not plain:
        raise UsageError(f"{dialect.name} has no read that needs no value, so its drives cannot be looked for")
    ranks = {verb: rank for rank, verb in enumerate(_SEARCH_READS)}
    return sorted(plain, key=lambda c: ranks.get(c.verb, len(ranks)))


def search_read(dialect: Dialect, address: int | None = None, gate: Gate | None = None) -> Command:
    """Return the read by which a drive is looked for: the best, or the best of those that a gate lets through to it.

    A question may do something to a drive of another dialect of the bus; another one then does not. Where each does: the best.
    """
    reads = search_reads(dialect)
    if gate is None or address is None:
        return reads[0]
    return next((c for c in reads if not gate.objections(assemble(dialect, c, address).item())), reads[0])


def _is_plain_read(command: Command) -> bool:
    fields = command.request_forms[0].layout.named if command.request_forms else {"none": None}
    return command.all_risks == {Risk.READ} and not fields and not command.models and bool(command.reply_forms)


def scan(
    gate: Gate,
    dialects: Sequence[Dialect],
    *,
    addresses: Iterable[int] | Mapping[str, Iterable[int]] = range(1, 33),
    rates: Sequence[int] = (),
    patience_ns: int = PATIENCE_NS,
    late_ns: int = 0,
    busy: bool = False,
    enough: Callable[[Found], bool] | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Look for drives and return what was found; the line is left at the rate it had.

    `addresses`: of every dialect, or by its name; those that a dialect's drives cannot have are left out. `rates`: bits per
    second in the order in which they are tried, none: the line's own alone. `busy`: ask although others speak. `enough`:
    end with the first drive for which it holds. `patience_ns`, `late_ns`: how long each is waited for, and how long answers
    are listened to at the end that come later than that. `report`: what to fill, for those who want it after Ctrl-C.

    Raises LineLost.
    """
    report = Report() if report is None else report
    line = gate.line
    own = line.endpoint.bits_per_second
    kinds = [d for d in dialects if d.bus == line.endpoint.bus_kind]
    plan = {d.name: _possible(d, addresses[d.name] if isinstance(addresses, Mapping) else addresses) for d in kinds}
    report.dialects, report.kind = tuple(d.name for d in kinds), line.endpoint.bus_kind
    tried = list(rates) or [own]
    total = len(tried) * sum(len(each) for each in plan.values())

    def report_progress(where: str) -> None:
        if progress is not None:
            progress(report.asked, total, where)

    try:
        for rate in tried:
            if rate != line.endpoint.bits_per_second:
                gate.set_speed(rate)
            finder = Finder(gate, kinds, patience_ns)
            if not _scan_rate(finder, plan, rate, busy, enough, report, report_progress):
                break
            report.found += _later(finder, late_ns, report)
    finally:
        if line.endpoint.bits_per_second != own:
            gate.set_speed(own)
    echo = getattr(line, "echo", None)
    report.echoes = bool(echo is not None and echo.dropped)
    return report


def _later(finder: Finder, late_ns: int, report: Report) -> list[Found]:
    """Listen for answers that come later than they were waited for; return the drives that were not known."""
    if not late_ns:
        return []
    known = {(f.dialect.name, f.address) for f in report.found}
    heard = [a for a in finder.dialogue.listen(late_ns).answers if a.message.role is Role.REPLY and a.message.frame.checksum_ok]
    speed = finder.dialogue.gate.line.endpoint.bits_per_second
    found = [Found(a.message.frame.dialect, a.message.address, speed, late_ns, a.data) for a in heard]
    return [f for f in found if (f.dialect.name, f.address) not in known]


def _possible(dialect: Dialect, addresses: Iterable[int]) -> list[int]:
    first, last = dialect.addresses
    return [a for a in addresses if first <= a <= last]


def _scan_rate(
    finder: Finder,
    plan: Mapping[str, Sequence[int]],
    rate: int,
    busy: bool,
    enough: Callable[[Found], bool] | None,
    report: Report,
    report_progress: Callable[[str], None],
) -> bool:
    """Ask all addresses at one rate; return whether to go on with the next one."""
    report.rates.append(rate)
    before = finder.dialogue.listen(LISTEN_NS)
    report.others.update(message.who for message in before.foreign)
    if before.received:
        report.strays.append(Stray(rate, "", before.received, _stray_kind(before, None, None)))
        if any(a.message.role is not Role.UNKNOWN for a in before.others) and not busy:
            report.stopped = "others speak on this bus, so nothing was asked"
            return False
    for dialect in finder.dialogue.dialects:
        for address in plan[dialect.name]:
            report_progress(f"{dialect.name} at {rate}, address {address}")
            report.asked += 1
            try:
                found, exchange = finder.find(dialect, address)
            except Refused:
                report.refused.append(drive_name(dialect, address))
                continue
            report.keep(rate, exchange)
            report.others.update(message.who for message in exchange.foreign)
            if found is not None:
                known = {(f.dialect.name, f.address, f.speed) for f in report.found}
                for each in (found, *finder.late(exchange, dialect, address)):
                    if (place := (each.dialect.name, each.address, each.speed)) not in known:
                        known.add(place)
                        report.found.append(each)
                    if enough is not None and enough(each):
                        return False
            elif exchange.received:
                kind = _stray_kind(exchange, dialect, address)
                report.strays.append(Stray(rate, drive_name(dialect, address), exchange.received, kind))
    return True


class Finder:
    """Asks single drives whether they are there."""

    def __init__(self, gate: Gate, dialects: Sequence[Dialect], patience_ns: int = PATIENCE_NS) -> None:
        # This gate allows reads alone; both gates know what was sent on the line.
        self.dialogue = Dialogue(gate.under(Allowance()), dialects)
        self._patience_ns = patience_ns

    def find(self, dialect: Dialect, address: int) -> tuple[Found | None, Exchange]:
        """Ask for a drive; return it, if one answered, and the exchange. Raises LineLost."""
        command = search_read(dialect, address, self.dialogue.gate)
        exchange = self._ask(dialect, command, address)
        answers = [a for a in exchange.answers if _is_of(a, dialect) and (a.paired or _may_answer(a, command, address))]
        # A late answer of a drive that was asked before is not this one's, as long as there is another.
        answer = next((a for a in answers if exchange.owns(a) or not a.paired), next(iter(answers), None))
        return None if answer is None else self._found(answer, dialect, address, command), exchange

    def late(self, exchange: Exchange, dialect: Dialect, address: int) -> list[Found]:
        """Return the drives whose answers to earlier questions came with that of another drive."""
        command = search_read(dialect, address, self.dialogue.gate)
        others = [a for a in exchange.answers if _is_of(a, dialect) and a.paired and not exchange.owns(a)]
        return [self._found(a, dialect, address, command) for a in others]

    def _found(self, answer: Answer, dialect: Dialect, address: int, command: Command) -> Found:
        message = answer.message
        wrong = "" if message.frame.checksum_ok else "its checksum is wrong"
        if message.address != address:
            wrong = f"it answered for {message.who} when {drive_name(dialect, address)} was asked"
        # No drive has this address, so it was the drive at the asked one that answered wrongly.
        place = message.address if _possible(dialect, [message.address]) else address
        values = dict(physical(message)) | self._more(dialect, place, command)
        speed = self.dialogue.gate.line.endpoint.bits_per_second
        return Found(dialect, place, speed, answer.latency_ns, answer.data, values, wrong)

    def _more(self, dialect: Dialect, address: int, asked: Command) -> dict[str, Any]:
        values: dict[str, Any] = {}
        for verb in _MORE:
            command = dialect.by_verb.get(verb)
            if command is None or command is asked or not _is_plain_read(command):
                continue
            for reply in self._ask(dialect, command, address).replies:
                if reply.message.frame.checksum_ok and reply.meaning == "final":
                    values |= physical(reply.message)
        return values

    def _ask(self, dialect: Dialect, command: Command, address: int) -> Exchange:
        built = assemble(dialect, command, address)
        line = self.dialogue.gate.line
        # What has begun by then is heard to its end; a CAN frame comes as a whole.
        wire_ns = line.byte_ns or 200 * _SECOND_NS // line.endpoint.bits_per_second
        asked = self.dialogue.send(built.item())
        return self.dialogue.collect(asked, lambda exchange, new: any(map(exchange.owns, new)), wire_ns + self._patience_ns)


def _is_of(answer: Answer, dialect: Dialect) -> bool:
    """Say whether a frame is a drive's of this dialect: its reply, or Modbus' refusal to answer."""
    message = answer.message
    if message.frame.dialect.name != dialect.name or message.role is not Role.REPLY:
        return False
    return message.frame.checksum_ok or message.form is not None


def _may_answer(answer: Answer, asked: Command, address: int) -> bool:
    """Say whether a reply may be to what was asked: by its address, or by its command and a fitting checksum.

    On a CAN bus any node sends, and what it sends may look like some reply with a wrong checksum.
    """
    if answer.message.address == address:
        return True
    return answer.message.frame.checksum_ok and answer.command is not None and answer.command.name == asked.name


def _stray_kind(exchange: Exchange, dialect: Dialect | None, address: int | None) -> StrayKind:
    """Say what bytes look like that came and are no answer."""
    for other in exchange.others:
        message = other.message
        if dialect is None or message.role is Role.REQUEST:
            return StrayKind.REQUEST
        if message.frame.dialect.name != dialect.name:
            return StrayKind.OTHER_DIALECT
        if message.address != address:
            return StrayKind.REPLY
    low = sum(byte == 0 for byte in exchange.received)
    return StrayKind.LOW if low * 4 >= len(exchange.received) * 3 else StrayKind.WRONG_RATE
