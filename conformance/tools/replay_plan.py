"""The plan of a replay: the requests of a recording in order, each with its time and recorded replies.

    capture or log -> the analyzer's pipeline -> steps

A step is a request with its bytes as recorded, good or bad: the analyzer separates it from replies. Items of an unknown
role (junk, a CAN frame of 29 bits) and echoes of an adapter are left out and counted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

from analyzer.catalogue import Dialect, Role
from analyzer.entries import Entry, Sink
from analyzer.pipeline import Item, Pipeline
from analyzer.records import CanFrame, Comment, Finding, Junk, Message
from conformance.gate import gate

#: The finding of a request that an adapter handed back.
_ECHO = "host_echo"


@dataclass(frozen=True, slots=True)
class Reply:
    """A reply, as far as two of them are compared. `reads`: its command only reads."""

    name: str
    form: str
    status: int | None
    data: bytes
    reads: bool

    @property
    def kind(self) -> tuple[str, str, int | None]:
        """Command, form and status: they have to be the same."""
        return (self.name, self.form, self.status)


def reply_of(message: Message) -> Reply:
    """Return a reply as it is compared."""
    command, form = message.command, message.form
    name = command.name if command is not None else "unknown"
    if command is None or form is None:
        return Reply(name, "unreadable", None, message.frame.data, True)
    reads = all(not rule.risks - {"read"} for rule in command.risk)
    named = command.replies.status
    judged = command.judged and named in form.layout.named
    status = message.values.get(named) if judged and not reads else None
    shape = form.name if message.frame.checksum_ok else f"{form.name}, its checksum wrong"
    return Reply(name, shape, status, message.frame.data, reads)


@dataclass(slots=True)
class Step:
    """One request: its time in the recording, what is sent, and the recorded replies; `reply_ns`: until the last of them."""

    t_ns: int
    item: gate.Item
    message: Message
    replies: list[Reply] = field(default_factory=list)
    reply_ns: int = 0

    @property
    def name(self) -> str:
        return self.message.command.name if self.message.command is not None else "unknown"

    @property
    def address(self) -> int:
        return self.message.address

    @property
    def dialect(self) -> Dialect:
        """The dialect it was read in."""
        return self.message.frame.dialect


@dataclass
class Plan:
    """The steps of a recording, in order. `left_out`: what is not sent, by reason."""

    steps: list[Step] = field(default_factory=list)
    buses: Counter[str] = field(default_factory=Counter)
    left_out: Counter[str] = field(default_factory=Counter)

    @property
    def duration_ns(self) -> int:
        """From the first request to the last one."""
        return self.steps[-1].t_ns - self.steps[0].t_ns if self.steps else 0

    @property
    def period_ns(self) -> int:
        """After what time it can be begun again: its duration and one usual gap."""
        return self.duration_ns + (self.duration_ns // (len(self.steps) - 1) if len(self.steps) > 1 else 10**9)


class _Reader:
    """A sink that makes steps."""

    def __init__(self, bus: str, addresses: frozenset[int] | None) -> None:
        self.plan = Plan()
        self._bus = bus
        self._addresses = addresses
        self._open: dict[int, Step] = {}
        self._same: dict[gate.Item, gate.Item] = {}

    def entry(self, entry: Entry) -> None:
        message = entry.message
        frame = message.frame
        if message.role is Role.REQUEST:
            self.plan.buses[frame.port] += 1
        if self._bus and frame.port != self._bus:
            return
        if message.role is Role.FOREIGN or not frame.dialect.of_drives:
            self.plan.left_out["frames that are not of this dialect"] += 1
        elif message.role is Role.REQUEST:
            self._request(entry)
        elif message.role is Role.UNKNOWN:
            self.plan.left_out["frames of an unknown sender"] += 1
        elif entry.request_sequence is not None and entry.request_sequence in self._open:
            step = self._open[entry.request_sequence]
            step.reply_ns = max(0, frame.last_ns - step.t_ns)
            step.replies.append(reply_of(message))

    def _request(self, entry: Entry) -> None:
        message = entry.message
        frame = message.frame
        if any(f.rule == _ECHO for f in entry.findings):
            self.plan.left_out["echoes of an adapter"] += 1
            return
        if self._addresses is not None and message.address not in self._addresses:
            self.plan.left_out["requests to other addresses"] += 1
            return
        item: gate.Item = frame.data if frame.can is None else CanFrame(None, "host", frame.can.id, frame.can.data)
        item = self._same.setdefault(item, item)
        step = Step(frame.first_ns, item, message)
        self.plan.steps.append(step)
        self._open[entry.sequence] = step

    def junk(self, junk: Junk, sequence: int, topic: str) -> None:
        if not self._bus or junk.port == self._bus:
            self.plan.left_out["pieces of junk"] += 1

    def finding(self, found: Finding) -> None:
        """Do nothing: what was wrong then is not what is sent now."""

    def comment(self, comment: Comment) -> None:
        """Do nothing: a comment is not traffic."""


def make_plan(
    items: Iterable[Item],
    pipeline: Callable[[Sequence[Sink]], Pipeline],
    *,
    bus: str = "",
    addresses: frozenset[int] | None = None,
) -> Plan:
    """Return the plan of a recording.

    `pipeline`: makes what decodes it into sinks. `bus`: of this one alone; `addresses`: of requests to these alone.
    """
    reader = _Reader(bus, addresses)
    pipeline([reader]).run(items)
    reader.plan.steps.sort(key=lambda step: step.t_ns)
    return reader.plan
