"""A drive that does little, for tests of what is around drives: it answers reads, and a move twice."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from analyzer import dialects
from analyzer.catalogue import Verb
from analyzer.records import Frame
from conformance.drives.drive import Drive, Outgoing, Request, Responder, Rest, Values

MOVE_NS = 50_000_000


class PlainDrive(Drive):
    """Answers every command of its address that has a reply with zeros; a move also when it is done, after 50 ms."""

    def __init__(self, dialect: str, address: int, *, delay_ns: int = 0, **settings: int) -> None:
        super().__init__((Responder(dialects.get(dialect)),), address, settings=settings)
        self.reply_delay_ns = delay_ns
        self.heard: list[Frame] = []
        self.taken: list[tuple[int, str]] = []
        self._moves: list[tuple[int, Request]] = []

    def receive(self, frame: Frame, t_ns: int) -> list[Outgoing]:
        assert t_ns >= self.now_ns, "time runs backwards"
        self.heard.append(frame)
        return super().receive(frame, t_ns)

    def advance(self, t_ns: int) -> list[Outgoing]:
        assert t_ns >= self.now_ns, "time runs backwards"
        return super().advance(t_ns)

    def behave(self, request: Request) -> Values | None:
        command = request.command
        if not command.reply_forms:
            return None
        self.taken.append((self.now_ns, command.name))
        if command.verb is Verb.SET_BAUD_RATE:
            self.settings["baud_rate"] = request.values["baud_rate"]
        if command.verb is Verb.MOVE_RELATIVE_PULSES:
            self._moves.append((self.now_ns + MOVE_NS, request))
        return self._zeros(request, 1)

    def refused(self, request: Request) -> Values | None:
        return self.behave(request)

    def _zeros(self, request: Request, status: int) -> Values:
        fields = request.command.reply_forms[0].layout.named
        return {name: status if name == "status" else 0 for name in fields}

    def hold(self, settings: Mapping[str, int]) -> None:
        self.settings.update(settings)

    def stand(self, told: Mapping[str, int]) -> None:
        return

    def foresee(self) -> tuple[int, Callable[[], None]] | None:
        return (self._moves[0][0], self._arrive) if self._moves else None

    def _arrive(self) -> None:
        _, request = self._moves.pop(0)
        self.answer(request, self._zeros(request, 2), True, self.address, self.now_ns)

    counts_per_turn = 16384
    rest = Rest(0, 0, 0)

    def hot(self, temperature: float) -> None:
        return

    def power_cycle(self, t_ns: int) -> None:
        self._moves.clear()
        self.changed()
