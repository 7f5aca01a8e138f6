"""A drive that does little, for tests of what is around drives: it answers reads, and a move twice."""

from __future__ import annotations

from analyzer import dialects
from analyzer.catalogue import Role, Verb
from analyzer.decoder import Decoder
from analyzer.encoder import build
from analyzer.records import Frame
from conformance.drives.drive import Drive, Outgoing

MOVE_NS = 50_000_000


class PlainDrive(Drive):
    """Answers every command of its address that has a reply with zeros; a move also when it is done, after 50 ms."""

    def __init__(self, dialect: str, address: int, *, delay_ns: int = 0, **settings: int) -> None:
        super().__init__(dialects.get(dialect), address, settings=settings)
        self.delay_ns = delay_ns
        self.heard: list[Frame] = []
        self.taken: list[tuple[int, str]] = []
        self._done: list[tuple[int, str]] = []
        self._decoder = Decoder(self.dialect)

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        assert t_ns >= self.now_ns, "time runs backwards"
        self.now_ns = t_ns
        self.heard.append(frame)
        message, _ = self._decoder.decode(frame)
        if not frame.checksum_ok or message.address != self.address or message.role is not Role.REQUEST:
            return []
        command = message.command
        if command is None or not command.reply_forms:
            return []
        self.taken.append((t_ns, command.name))
        if command.verb is Verb.SET_BAUD_RATE:
            self.settings["baud_rate"] = message.values["baud_rate"]
        if command.verb is Verb.MOVE_RELATIVE_PULSES:
            self._done.append((t_ns + MOVE_NS, command.name))
        return [self._answer(t_ns + self.delay_ns, command.name, 1)]

    def _answer(self, at_ns: int, name: str, status: int) -> Outgoing:
        has_status = "status" in self.dialect.by_name[name].reply_forms[0].layout.named
        values = {"status": status} if has_status else {}
        return Outgoing(at_ns, build(self.dialect, name, self.address, values, Role.REPLY))

    def advance(self, t_ns: int) -> list[Outgoing]:
        assert t_ns >= self.now_ns, "time runs backwards"
        self.now_ns = t_ns
        due = [(done_ns, name) for done_ns, name in self._done if done_ns <= t_ns]
        self._done = [each for each in self._done if each[0] > t_ns]
        return [self._answer(done_ns, name, 2) for done_ns, name in due]

    def next_ns(self) -> int | None:
        return min((done_ns for done_ns, _ in self._done), default=None)

    def power_cycle(self, t_ns: int) -> None:
        self._done.clear()
