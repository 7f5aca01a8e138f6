"""Finding drives: reads to addresses, dialects and rates, and what the answers, or the noises, say.

    report = scan(gate, dialects, addresses=range(1, 33), rates=(38400, 115200))
    report.found, report.hints

Only reads are sent, through a gate that allows nothing else. For each dialect it is the read that every drive of it answers
and that says most (a status, a state); a drive that answered is asked for more: its version, where it can tell one.

Before the first byte the line is listened to: on a bus that a machine uses, a question at the wrong moment spoils what
others say, so there nothing is sent unless the caller wants it (`busy`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from analyzer.catalogue import Command, Dialect, Risk, Role, Verb
from analyzer.decoder import physical
from analyzer.encoder import build
from analyzer.errors import UsageError
from analyzer.pipeline import Entry
from conformance.gate.gate import Gate
from conformance.gate.permissions import Allowance
from conformance.talk.dialogue import MS, Dialogue, Talk
from conformance.talk.drive_state import item_of

#: What is asked first, the best first: each is answered by any drive that has it, whatever it is doing.
_QUESTIONS = (Verb.READ_STATUS, Verb.READ_STATE_1, Verb.READ_VERSION, Verb.READ_SPEED, Verb.READ_POSITION)
#: What a drive that answered is asked besides.
_MORE = (Verb.READ_VERSION, Verb.READ_STATE_1, Verb.READ_ENABLED, Verb.READ_SPEED)
#: How long an answer may take beside its time on the wire: a drive's own, and an adapter's latency timer.
PATIENCE_NS = 40 * MS
#: How long is listened before anything is sent.
LISTEN_NS = 250 * MS
_REPLY_BYTES = 14
_SECOND_NS = 1_000_000_000


class Look(StrEnum):
    """What bytes look like that came and are no answer."""

    REPLY = "a reply from another address"
    OTHER_DIALECT = "a frame of another dialect"
    LOW = "a line that stays low"
    WRONG_RATE = "no frames: another rate, or noise"
    REQUEST = "requests of another host"


@dataclass(frozen=True)
class Found:
    """A drive that answered. `asked`: the address it was asked at, where that is another; `said`: fields it told."""

    dialect: Dialect
    address: int
    speed: int
    latency_ns: int
    reply: bytes
    said: Mapping[str, Any] = field(default_factory=dict)
    wrong: str = ""

    @property
    def name(self) -> str:
        """DIALECT@ADDRESS."""
        return f"{self.dialect.name}@{self.address}"

    @property
    def identity(self) -> str:
        """Firmware and type, as far as it told any."""
        said = self.said
        parts = [str(said["hardware_name"])] if "hardware_name" in said else []
        if "firmware_major" in said:
            version = ".".join(str(said[f"firmware_{n}"]) for n in ("major", "minor", "patch") if f"firmware_{n}" in said)
            parts.append(f"firmware {version}")
        if "voltage" in said:
            parts.append(f"{said['voltage']:g} V")
        return ", ".join(parts)


@dataclass(frozen=True)
class Heard:
    """Bytes that came and are no answer, when which question was asked at which rate. `asked` empty: none was."""

    speed: int
    asked: str
    data: bytes
    look: Look


@dataclass
class Report:
    """What a scan found. `rates`: at which it looked; `stopped`: why it did not look everywhere, or nothing."""

    found: list[Found] = field(default_factory=list)
    heard: list[Heard] = field(default_factory=list)
    asked: int = 0
    rates: list[int] = field(default_factory=list)
    dialects: tuple[str, ...] = ()
    echoes: bool = False
    stopped: str = ""
    kind: str = "serial"

    @property
    def hints(self) -> list[str]:
        """What to look at, by what was found and heard."""
        from conformance.tools.scan_hints import hints

        return hints(self)


#: Called as a scan goes on: questions asked, questions there are, and where it is.
Progress = Callable[[int, int, str], None]


def question(dialect: Dialect) -> Command:
    """Return the read by which a drive of a dialect is looked for: one without values, that changes nothing."""
    plain = [c for c in dialect.commands if _is_plain_read(c)]
    if not plain:
        raise UsageError(f"{dialect.name} has no read that needs no value, so its drives cannot be looked for")
    ranks = {verb: rank for rank, verb in enumerate(_QUESTIONS)}
    return min(plain, key=lambda c: ranks.get(c.verb, len(ranks)))


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
    busy: bool = False,
    enough: Callable[[Found], bool] | None = None,
    progress: Progress | None = None,
    report: Report | None = None,
) -> Report:
    """Look for drives and return what was found; the line is left at the rate it had.

    `addresses`: of every dialect, or by its name; those that a dialect's drives cannot have are left out. `rates`: bits per
    second in the order in which they are tried, none: the line's own alone. `busy`: ask although others speak. `enough`:
    end with the first drive for which it holds. `report`: what to fill, for those who want it after Ctrl-C. Raises LineLost.
    """
    report = Report() if report is None else report
    line = gate.line
    own = line.endpoint.bits_per_second
    kinds = [d for d in dialects if d.bus == line.endpoint.bus_kind]
    plan = {d.name: _possible(d, addresses[d.name] if isinstance(addresses, Mapping) else addresses) for d in kinds}
    report.dialects, report.kind = tuple(d.name for d in kinds), line.endpoint.bus_kind
    tried = list(rates) or [own]
    total = len(tried) * sum(len(each) for each in plan.values())
    try:
        for rate in tried:
            if rate != line.endpoint.bits_per_second:
                gate.set_speed(rate)
            if not _look(gate, kinds, plan, rate, patience_ns, busy, enough, report, total, progress):
                break
    finally:
        if line.endpoint.bits_per_second != own:
            gate.set_speed(own)
    echo = getattr(line, "echo", None)
    report.echoes = bool(echo is not None and echo.dropped)
    return report


def _possible(dialect: Dialect, addresses: Iterable[int]) -> list[int]:
    first, last = dialect.addresses
    return [a for a in addresses if first <= a <= last]


def _look(
    gate: Gate,
    dialects: Sequence[Dialect],
    plan: Mapping[str, Sequence[int]],
    rate: int,
    patience_ns: int,
    busy: bool,
    enough: Callable[[Found], bool] | None,
    report: Report,
    total: int,
    progress: Progress | None,
) -> bool:
    """Look at one rate; return whether to go on with the next one."""
    asker = Asker(gate, dialects, patience_ns)
    report.rates.append(rate)
    before = asker.dialogue.listen(LISTEN_NS)
    if before.heard:
        report.heard.append(Heard(rate, "", before.heard, look_of(before, None, None)))
        if any(e.message.role is not Role.UNKNOWN for e in before.others) and not busy:
            report.stopped = "others speak on this bus, so nothing was asked"
            return False
    for dialect in dialects:
        for address in plan[dialect.name]:
            if progress is not None:
                progress(report.asked, total, f"{dialect.name} at {rate}, address {address}")
            report.asked += 1
            found, talk = asker.ask(dialect, address)
            if found is not None:
                known = {(f.dialect.name, f.address, f.speed) for f in report.found}
                if (found.dialect.name, found.address, found.speed) not in known:
                    report.found.append(found)
                if enough is not None and enough(found):
                    return False
            elif talk.heard:
                look = look_of(talk, dialect, address)
                report.heard.append(Heard(rate, f"{dialect.name}@{address}", talk.heard, look))
    return True


class Asker:
    """Asks single drives whether they are there."""

    def __init__(self, gate: Gate, dialects: Sequence[Dialect], patience_ns: int = PATIENCE_NS) -> None:
        # A gate of reads alone, whatever the other one allows; both know what was sent on the line.
        self.dialogue = Dialogue(gate.under(Allowance()), dialects)
        self._patience_ns = patience_ns

    def ask(self, dialect: Dialect, address: int) -> tuple[Found | None, Talk]:
        """Ask for a drive; return it, if one answered, and the talk. Raises LineLost."""
        command = question(dialect)
        talk = self._talk(dialect, command, address)
        answer = next((e for e in talk.entries if _answers(e, dialect)), None)
        if answer is None:
            return None, talk
        message = answer.message
        wrong = "" if message.frame.checksum_ok else "its checksum is wrong"
        if message.address != address:
            wrong = f"it answered for {message.address} when {address} was asked"
        said = dict(physical(message)) | self._more(dialect, message.address, command)
        speed = self.dialogue.gate.line.endpoint.bits_per_second
        return Found(dialect, message.address, speed, talk.latency_ns(answer), message.frame.data, said, wrong), talk

    def _more(self, dialect: Dialect, address: int, asked: Command) -> dict[str, Any]:
        said: dict[str, Any] = {}
        for verb in _MORE:
            command = dialect.by_verb.get(verb)
            if command is None or command is asked or not _is_plain_read(command):
                continue
            talk = self._talk(dialect, command, address)
            for entry in talk.replies:
                if entry.message.frame.checksum_ok and talk.meaning(entry) == "final":
                    said |= physical(entry.message)
        return said

    def _talk(self, dialect: Dialect, command: Command, address: int) -> Talk:
        frame = build(dialect, command, address)
        line = self.dialogue.gate.line
        wire_ns = (len(frame) + _REPLY_BYTES) * line.byte_ns or 200 * _SECOND_NS // line.endpoint.bits_per_second
        return self.dialogue.ask(item_of(dialect, frame, address), wire_ns + self._patience_ns)


def _answers(entry: Entry, dialect: Dialect) -> bool:
    """Say whether a frame is a drive's of this dialect: its reply, or Modbus' refusal to answer."""
    message = entry.message
    if message.frame.dialect.name != dialect.name or message.role is not Role.REPLY:
        return False
    return message.frame.checksum_ok or message.form is not None


def look_of(talk: Talk, dialect: Dialect | None, address: int | None) -> Look:
    """Say what bytes look like that came and are no answer."""
    for entry in talk.others:
        message = entry.message
        if dialect is None or message.role is Role.REQUEST:
            return Look.REQUEST
        if message.frame.dialect.name != dialect.name:
            return Look.OTHER_DIALECT
        if message.address != address:
            return Look.REPLY
    low = sum(byte == 0 for byte in talk.heard)
    return Look.LOW if low * 4 >= len(talk.heard) * 3 else Look.WRONG_RATE
