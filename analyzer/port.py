"""One bus of the pipeline: its framer (serial), decoders, context and transactions, and what it is set up for.

The dialects of a bus can change while it is read: when they were found out from the traffic, or when a log says so. What
waits is decided first; open requests and what was learnt of the drives stay.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from analyzer import dialects as registry
from analyzer.catalogue import Command, Dialect, Role
from analyzer.context import Context
from analyzer.decoder import Decoder
from analyzer.foreign import Likeness, Nodes
from analyzer.framer import SILENCE_NS, Framer
from analyzer.link import EXTENDED_ID
from analyzer.records import CanFrame, Event, Frame, Junk, Message
from analyzer.transactions import Transactions
from analyzer.values import CAN_ID_LIMIT


@dataclass(frozen=True, slots=True)
class Options:
    """What a user can choose.

    `byte_ns`: time of one byte on the line, 0 if unknown; `synthetic_byte_ns` and `synthetic_bit_ns` estimate the times of a
    capture that has none (serial bytes, CAN bits). With `timed` False they tell no latency. `listed`: who is a drive, None: the
    frames tell.
    """

    byte_ns: int = 0
    synthetic_byte_ns: int = 10_000_000_000 // 38400
    synthetic_bit_ns: int = 2000
    timed: bool = True
    late_ns: int = 1_000_000_000
    silence_ns: int = SILENCE_NS
    groups: frozenset[int] = field(default_factory=frozenset)
    listed: frozenset[int] | None = None


@dataclass(frozen=True, slots=True)
class PortSetup:
    """What differs from bus to bus.

    `dialects`: all that may be on it. `byte_ns`, `listed`: None: as `Options` has it. `offset`: bytes of the bus that came
    before the first one here; it counts only for a bus that is new.
    """

    dialects: tuple[Dialect, ...]
    byte_ns: int | None = None
    offset: int = 0
    listed: frozenset[int] | None = None


def topic_name(text: str) -> str:
    """Return a text as one part of a topic: letters, digits, `_`, `-` and `.`; anything else becomes `_`."""
    cleaned = "".join(c if (c.isascii() and c.isalnum()) or c in "_-." else "_" for c in text.strip())
    return cleaned or "bus"


class Port:
    """One bus."""

    def __init__(self, name: str, setup: PortSetup, options: Options) -> None:
        self.name = name
        self.bus = topic_name(name)
        self.setup = setup
        self._options = options
        self.decoders: dict[str, Decoder] = {}
        self.nodes = Nodes(options.listed)
        self.clock_ns = 0
        #: Place of the first byte here, and of the next one.
        self.start = self.bytes_in = setup.offset
        self._request_topics: dict[tuple[int, str], str] = {}
        self._reply_topics: dict[tuple[int, str], str] = {}
        self.renew()

    def _build(self, setup: PortSetup) -> None:
        self.setup = setup
        # Decoders of dialects that are left stay, for what has waited until now.
        for dialect in setup.dialects:
            known = self.decoders.get(dialect.name)
            if known is None or known.dialect is not dialect:
                self.decoders[dialect.name] = Decoder(dialect)
        self.serial = [d for d in setup.dialects if d.bus == "serial"]
        can = [d for d in setup.dialects if d.bus == "can"]
        self.can = [d for d in can if not d.link.by_identifier]
        #: Those that describe the messages of other nodes.
        self.described = [d for d in can if d.link.by_identifier]
        # What no check speaks for comes last.
        self._by_evidence = sorted(self.can, key=lambda d: not d.link.checked)
        self._alike = {d.name: Likeness(d) for d in self.can}
        self.nodes.listed = self._options.listed if setup.listed is None else setup.listed
        byte_ns = self._options.byte_ns if setup.byte_ns is None else setup.byte_ns
        self.framer = None
        if self.serial:
            silence_ns, offset = self._options.silence_ns, self.bytes_in
            self.framer = Framer(self.name, self.serial, self.context, byte_ns=byte_ns, silence_ns=silence_ns, offset=offset)

    def change(self, setup: PortSetup) -> Iterator[Frame | Junk]:
        """Go over to another setup; yield what waited until now, then the change is made. Use all of it up."""
        if self.framer is not None:
            yield from self.framer.silence()
        before = self.framer.state() if self.framer is not None else None
        self._build(setup)
        if before is not None and self.framer is not None:
            # All bytes are given away: what is left are the clock and the place on the line.
            self.framer.restore(before)

    def renew(self) -> None:
        """Begin, or begin anew behind all that has come, with nothing open: after a fault in decoding."""
        self.context = Context(self._options.groups)
        self._build(self.setup)
        self.transactions = Transactions(
            self.context, late_ns=self._options.late_ns, half_duplex=self.framer is not None, timed=self._options.timed
        )

    def describes(self, can: CanFrame) -> Dialect | None:
        """Return the dialect that describes a CAN frame by its identifier, the first of several; None if it is for drives."""
        if not self.described or can.error or can.remote or (self.nodes.listed is not None and can.id in self.nodes.listed):
            return None
        can_id = can.id | EXTENDED_ID if can.extended else can.id
        return next((d for d in self.described if d.link.claims(can_id)), None)

    def can_dialect(self, can: CanFrame) -> Dialect:
        """Return the dialect of a CAN frame: one whose check fits, else one without checks that has its code and length."""
        if len(self.can) == 1:
            return self.can[0]
        found = next((d for d in self._by_evidence if self._evident(d, can)), None)
        return found or next((d for d in self.can if not d.link.left_out), self.can[0])

    def _evident(self, dialect: Dialect, can: CanFrame) -> bool:
        if dialect.link.checked:
            return dialect.link.fits(can.data, can.id)
        return self._alike[dialect.name].fits(can)

    def serves(self, address: int, dialect: Dialect) -> bool | None:
        """Say whether an address is a drive's, None where the frame has to tell: what is for several drives is not listed."""
        known = self.nodes.knows(address)
        return None if known is False and (address == dialect.broadcast or address in self.context.groups) else known

    def from_drive(self, frame: Frame, can: CanFrame, *, usual: bool) -> bool:
        """Say whether a CAN frame is a drive's, or for one. `usual`: its identifier, type and length are of the dialect."""
        dialect = frame.dialect
        if can.extended or can.id > CAN_ID_LIMIT:
            return False
        known = self.serves(can.id, dialect)
        if known is not None:
            return known
        message = self.decoders[dialect.name].decode(frame, self.context)[0] if usual else None
        near = self._alike[dialect.name].is_near(can, checks=usual and frame.checksum_ok)
        return self.nodes.tells(can, message, near)

    def topic(self, message: Message) -> str:
        """Return the topic of a message."""
        command, role = message.command, message.role
        if role is Role.FOREIGN:
            return f"/{self.bus}/foreign"
        if command is None or role is Role.UNKNOWN:
            return f"/{self.bus}/unknown"
        return self.topic_of(message.address, command, role)

    def topic_of(self, address: int, command: Command, role: Role) -> str:
        """Return the topic of a command's requests or replies."""
        topics = self._request_topics if role is Role.REQUEST else self._reply_topics
        key = (address, command.name)
        known = topics.get(key)
        if known is None:
            who = "all" if command.slots is not None else str(address)
            known = topics[key] = f"/{self.bus}/{who}/{command.name}/{role}"
        return known

    def state(self) -> dict[str, Any]:
        """Return what was seen so far, for `restore`."""
        return {
            "start": self.start,
            "bytes_in": self.bytes_in,
            "clock_ns": self.clock_ns,
            "framer": None if self.framer is None else self.framer.state(),
            "context": vars(self.context),
            "transactions": {name: getattr(self.transactions, name) for name in Transactions.STATE},
            "nodes": {name: getattr(self.nodes, name) for name in Nodes.STATE},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on where another port of the same setup stood. Raises KeyError for a state that is not whole."""
        self.start, self.bytes_in, self.clock_ns = state["start"], state["bytes_in"], state["clock_ns"]
        vars(self.context).update(state["context"])
        for name in Transactions.STATE:
            setattr(self.transactions, name, state["transactions"][name])
        for name in Nodes.STATE:
            setattr(self.nodes, name, state["nodes"][name])
        if self.framer is not None and state["framer"] is not None:
            self.framer.restore(state["framer"])


def usual_setup(dialects: Sequence[Dialect]) -> PortSetup:
    """Return the setup of a bus of which nothing else is known."""
    return PortSetup(tuple(dialects))


class Setups:
    """Answers for `Pipeline.on_setup`. `dialects`: by name, as the wanted model speaks them."""

    def __init__(self, dialects: Mapping[str, Dialect]) -> None:
        self.dialects = dict(dialects)

    def __call__(self, event: Event) -> PortSetup | None:
        """Return the setup of a bus from an event on, None where the event names no dialect.

        Raises UsageError for an unknown dialect.
        """
        names = event.values.get("dialects")
        if not names:
            return None
        chosen = tuple(self.dialects.get(name) or registry.get(name) for name in names)
        byte_ns, offset = event.values.get("byte_ns"), event.values.get("offset", 0)
        return PortSetup(
            chosen,
            byte_ns if isinstance(byte_ns, int) else None,
            offset if isinstance(offset, int) else 0,
            listed_in(event.values),
        )


def listed_in(values: Mapping[str, Any]) -> frozenset[int] | None:
    """Return who is a drive, as the values of an event say; None where they do not."""
    ids = values.get("ids")
    return frozenset(n for n in ids if isinstance(n, int)) if isinstance(ids, (list, tuple)) else None
